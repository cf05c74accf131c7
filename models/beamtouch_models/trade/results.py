"""The trade as a table, a plot and JSON."""

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from beamtouch_models.accuracy.statistics import Measurement
from beamtouch_models.charts import Chart, Series, Style, draw
from beamtouch_models.svg import standalone
from beamtouch_models.trade.physics import EffectLeftOut
from beamtouch_models.trade.point import Failure, Point, Trade
from beamtouch_models.trade.since_touch import Curve

HEADINGS = (
    "front",
    "estimator",
    "sensors",
    "filter",
    "error, % of length",
    "error, mm",
    "over limit",
    "p50, us",
    "p99, us",
    "batch 1000, us",
    "settles, ms",
    "poll, ms",
    "known after, ms",
    "kB",
)
FRONT_COLOUR = 7
"""The colours before it belong to three estimators in two precisions."""
PHYSICS_HEADINGS = ("effect", "price", "verdict", "error over limit without it", "influence table, ms", "with it, ms")


def json_of(
    trade: Trade, front: Sequence[Point], physics: Sequence[EffectLeftOut], curves: Sequence[Curve] = ()
) -> dict[str, Any]:
    """Return all results, for JSON."""
    return {
        "planned_points": trade.planned,
        "points": [{**_fields(point), "on_front": point in front} for point in trade.points],
        "failures": [{**asdict(failure), "filter": failure.filter.model_dump()} for failure in trade.failures],
        "physics": [asdict(effect) for effect in physics],
        "since_touch": [asdict(curve) for curve in curves],
    }


def _fields(point: Point) -> dict[str, Any]:
    return {**asdict(point), "filter": point.filter.model_dump()}


def row(point: Point, *, on_front: bool) -> tuple[str, ...]:
    """Return a point as the cells of a row."""
    return (
        "*" if on_front else "",
        f"{point.estimator}{' int8' if point.quantised else ''}",
        str(point.sensors),
        "none" if point.filter.window == 1 else f"mean of {point.filter.window}",
        f"{point.error_percent.value:.3f} ± {point.error_percent.standard_error:.3f}",
        f"{point.error_mm:.3g} ± {point.error_percent.standard_error / point.error_percent.value * point.error_mm:.1g}",
        f"{point.ratio.value:.4f} ± {point.ratio.standard_error:.4f}",
        f"{point.times.p50_us:.1f}",
        f"{point.times.p99_us:.1f}",
        f"{point.times.batch_us:.2f}",
        f"{point.filter.settling_ms:g}",
        f"{point.poll_ms:.2f}",
        f"{point.latency_ms:.3g}",
        f"{point.bytes / 1e3:.1f}",
    )


def physics_row(effect: EffectLeftOut) -> tuple[str, ...]:
    """Return an effect as the cells of a row."""
    error = effect.error_over_limit
    return (
        effect.effect,
        f"{effect.price:.3g}",
        effect.verdict,
        f"{error.value:.3f} ± {error.standard_error:.3f}",
        f"{effect.influence_ms:.2f}",
        f"{effect.influence_with_ms:.2f}",
    )


def markdown(
    name: str, trade: Trade, front: Sequence[Point], physics: Sequence[EffectLeftOut], curves: Sequence[Curve] = ()
) -> str:
    """Return the tables as Markdown."""
    lines = [
        f"# Accuracy against speed: {name}",
        "",
        f"{len(trade.points)} of {trade.planned} points, measured in one run on one machine. Points on the front (*)",
        "are not dominated by any other in time, error and number of sensors. A contact is known after half a reading",
        "period, the transfer of a reading at 1 Mbaud, the settling of the filter, and an inference.",
        "",
        *_table(HEADINGS, [row(point, on_front=point in front) for point in _sorted(trade.points)]),
        "",
        *(f"- Failed: {said(failure)}" for failure in trade.failures),
        *[""] * bool(trade.failures),
        *(since_touch_lines(curves) if curves else ()),
        "## Physics",
        "",
        "Each effect left out by itself: the error of an estimator without it, and the time to compute its influence",
        "table. Steps are left out of a beam without shear, because shear depends on the sections.",
        "",
        *_table(PHYSICS_HEADINGS, [physics_row(effect) for effect in physics]),
        "",
    ]
    return "\n".join(lines)


def since_touch_lines(curves: Sequence[Curve]) -> list[str]:
    """Return the section on error against time since touch."""
    cells = [
        (
            str(curve.sensors),
            str(number),
            f"{since_ms:g}",
            f"{error.value:.3f} ± {error.standard_error:.3f}",
            f"{least.value:.3f} ± {least.standard_error:.3f}",
        )
        for curve in curves
        for number, since_ms, error, least in zip(
            curve.readings, curve.since_ms, curve.error_percent, curve.limit_percent, strict=True
        )
    ]
    return [
        "## Since touch",
        "",
        "Mean error of the default estimator behind the growing mean, by the time since the first reading of a touch",
        "that the beam follows at once. The limit is the exact posterior of all these readings.",
        "",
        *_table(("sensors", "readings", "since touch, ms", "error, %", "limit, %"), cells),
        "",
    ]


def since_touch_plot(curves: Sequence[Curve], points: Sequence[Point]) -> str:
    """Return a plot of error over time since touch as SVG, beside the fixed filters of the default estimator."""
    series = []
    for colour, curve in enumerate(curves):
        shown = [number for number, since_ms in enumerate(curve.since_ms) if since_ms > 0]
        since_ms = [curve.since_ms[number] for number in shown]
        drawn: list[tuple[str, Sequence[Measurement], Style]] = [
            (f"{curve.sensors} sensors", curve.error_percent, "line"),
            ("", curve.limit_percent, "dashed"),
        ]
        for label, values, style in drawn:
            errors = [values[number].value for number in shown]
            series.append(Series(label, since_ms, errors, colour % FRONT_COLOUR, style))
        fixed = [
            point
            for point in points
            if (point.estimator, point.sensors, point.quantised) == ("posterior", curve.sensors, False)
            and point.filter.settling_ms > 0
        ]
        x = [point.filter.settling_ms for point in fixed]
        series.append(Series("", x, [point.error_percent.value for point in fixed], colour % FRONT_COLOUR, "points"))
    says = (
        "Mean error over the time since touch, one line per number of sensors. Dashed: the exact posterior of all "
        "readings. Points: fixed filters, once they have settled"
    )
    return standalone(draw(Chart(says, "since touch, ms", "mean |error|, %", series, log_x=True, log_y=True)))


def said(failure: Failure) -> str:
    """Return a line on what failed, and why."""
    window = failure.filter.window
    smoothing = "no filter" if window == 1 else f"mean of {window} readings"
    return f"{failure.estimator or 'every estimator'}, {failure.sensors} sensors, {smoothing}: {failure.reason}"


def plot(points: Sequence[Point], front: Sequence[Point]) -> str:
    """Return a plot of error over time as SVG; each point is labelled with its number of sensors."""
    kinds = list(dict.fromkeys((point.estimator, point.quantised) for point in points))
    series = []
    for colour, (name, is_quantised) in enumerate(kinds):
        some = [point for point in points if (point.estimator, point.quantised) == (name, is_quantised)]
        x, y = [point.latency_ms for point in some], [point.error_mm for point in some]
        notes = [f"{point.sensors}{'*' if point in front else ''}" for point in some]
        series.append(Series(f"{name}{', int8' if is_quantised else ''}", x, y, colour, "points", notes))
    best = sorted({(point.latency_ms, point.error_mm) for point in front})
    hull = [(x, y) for index, (x, y) in enumerate(best) if all(y < before for _, before in best[:index])]
    series.append(Series("front, any number of sensors", [x for x, _ in hull], [y for _, y in hull], FRONT_COLOUR))
    says = (
        "Mean error over the time until a contact is known, one point per way to build the model, labelled with its "
        "number of sensors, and with * on the front"
    )
    return standalone(draw(Chart(says, "known after, ms", "mean |error|, mm", series, log_x=True, log_y=True)))


def _sorted(points: Sequence[Point]) -> list[Point]:
    return sorted(points, key=lambda point: (point.sensors, point.filter.window, point.estimator, point.quantised))


def _table(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    return [
        "| " + " | ".join(headings) + " |",
        "|" + "---|" * len(headings),
        *("| " + " | ".join(cells) + " |" for cells in rows),
    ]
