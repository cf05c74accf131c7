"""The trade as tables and as JSON."""

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from beamtouch_common.digits import digits
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
PHYSICS_HEADINGS = ("effect", "price", "verdict", "error over limit without it", "influence table, ms", "with it, ms")


def json_of(
    trade: Trade, front: Sequence[Point], physics: Sequence[EffectLeftOut], curves: Sequence[Curve] = ()
) -> dict[str, Any]:
    """Return all results, for JSON."""
    return {
        "planned_points": trade.planned,
        "timed_alone": trade.timed_alone,
        "points": [{**_fields(point), "on_front": point in front} for point in trade.points],
        "failures": [{**asdict(failure), "filter": failure.filter.model_dump()} for failure in trade.failures],
        "physics": [asdict(effect) for effect in physics],
        "since_touch": [asdict(curve) for curve in curves],
    }


def _fields(point: Point) -> dict[str, Any]:
    return {**asdict(point), "filter": point.filter.model_dump()}


def row(point: Point, *, on_front: bool) -> tuple[str, ...]:
    """Return a point as the cells of a row."""
    standard_error_mm = point.error_percent.standard_error / point.error_percent.value * point.error_mm
    return (
        "*" if on_front else "",
        f"{point.estimator}{' int8' if point.quantised else ''}",
        str(point.sensors),
        "none" if point.filter.window == 1 else f"mean of {point.filter.window}",
        f"{point.error_percent.value:.3f} ± {point.error_percent.standard_error:.3f}",
        f"{digits(point.error_mm, 3)} ± {digits(standard_error_mm, 1)}",
        f"{point.ratio.value:.4f} ± {point.ratio.standard_error:.4f}",
        f"{point.times.p50_us:.1f}",
        f"{point.times.p99_us:.1f}",
        f"{point.times.batch_us:.2f}",
        f"{point.filter.settling_ms:g}",
        f"{point.poll_ms:.2f}",
        digits(point.latency_ms, 3),
        f"{point.bytes / 1e3:.1f}",
    )


def physics_row(effect: EffectLeftOut) -> tuple[str, ...]:
    """Return an effect as the cells of a row."""
    error = effect.error_over_limit
    return (
        effect.effect,
        digits(effect.price, 3),
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
        f"{len(trade.points)} of {trade.planned} points, timed in one run on one machine. Points on the front (*)",
        "are not dominated by any other in time, error and number of sensors. A contact is known after half a reading",
        "period, the transfer of a reading at 1 Mbaud, the settling of the filter, and an inference.",
        *(() if trade.timed_alone else ("Inferences were timed while other points were being measured.",)),
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


def said(failure: Failure) -> str:
    """Return a line on what failed, and why."""
    window = failure.filter.window
    smoothing = "no filter" if window == 1 else f"mean of {window} readings"
    return f"{failure.estimator or 'every estimator'}, {failure.sensors} sensors, {smoothing}: {failure.reason}"


def _sorted(points: Sequence[Point]) -> list[Point]:
    return sorted(points, key=lambda point: (point.sensors, point.filter.window, point.estimator, point.quantised))


def _table(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    return [
        "| " + " | ".join(headings) + " |",
        "|" + "---|" * len(headings),
        *("| " + " | ".join(cells) + " |" for cells in rows),
    ]
