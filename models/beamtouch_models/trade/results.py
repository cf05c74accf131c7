"""The trade as a table, a plot and JSON."""

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from beamtouch_models.charts import Chart, Series, draw, standalone
from beamtouch_models.trade.physics import LeftOut
from beamtouch_models.trade.points import Point

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


def json_of(points: Sequence[Point], front: Sequence[Point], physics: Sequence[LeftOut]) -> dict[str, Any]:
    """Everything, for JSON."""
    return {
        "points": [{**_fields(point), "on_front": point in front} for point in points],
        "physics": [asdict(effect) for effect in physics],
    }


def _fields(point: Point) -> dict[str, Any]:
    return {**asdict(point), "filter": point.filter.model_dump()}


def row(point: Point, *, on_front: bool) -> tuple[str, ...]:
    """A point as cells."""
    return (
        "*" if on_front else "",
        f"{point.estimator}{' int8' if point.quantised else ''}",
        str(point.sensors),
        "none" if point.filter.window == 1 else f"mean of {point.filter.window}",
        f"{point.error_percent.value:.3f} ± {point.error_percent.standard_error:.3f}",
        f"{point.error_mm:.3g}",
        f"{point.ratio.value:.3f}",
        f"{point.times.p50_us:.1f}",
        f"{point.times.p99_us:.1f}",
        f"{point.times.batch_us:.2f}",
        f"{point.filter.settling_ms:g}",
        f"{point.poll_ms:.2f}",
        f"{point.latency_ms:.3g}",
        f"{point.bytes / 1e3:.1f}",
    )


def physics_row(effect: LeftOut) -> tuple[str, ...]:
    """An effect as cells."""
    error = effect.error_over_limit
    return (
        effect.effect,
        f"{effect.price:.3g}",
        effect.verdict,
        f"{error.value:.3f} ± {error.standard_error:.3f}",
        f"{effect.influence_ms:.2f}",
        f"{effect.influence_with_ms:.2f}",
    )


def markdown(name: str, points: Sequence[Point], front: Sequence[Point], physics: Sequence[LeftOut]) -> str:
    """The tables as Markdown."""
    lines = [
        f"# What speed buys in accuracy: {name}",
        "",
        "Measured in one run on one machine. A point on the front (*) is beaten by no other in time, error and sensors",
        "at once. A contact is known after half a reading period, the transfer of a reading on a serial line of",
        "1 Mbaud, the filter's settling and an inference.",
        "",
        *_table(HEADINGS, [row(point, on_front=point in front) for point in _sorted(points)]),
        "",
        "## Physics",
        "",
        "Each effect left out by itself: what an estimator that knows nothing of it loses, and what the time of its",
        "influence table is.",
        "",
        *_table(PHYSICS_HEADINGS, [physics_row(effect) for effect in physics]),
        "",
    ]
    return "\n".join(lines)


def plot(points: Sequence[Point], front: Sequence[Point]) -> str:
    """Error over the time after which a contact is known, as SVG."""
    names = list(dict.fromkeys(point.estimator for point in points))
    series = [
        Series(
            name,
            [point.latency_ms for point in points if point.estimator == name and not point.quantised],
            [point.error_mm for point in points if point.estimator == name and not point.quantised],
            colour,
            "points",
        )
        for colour, name in enumerate(names)
    ]
    best = sorted({(point.latency_ms, point.error_mm) for point in front})
    hull = [(x, y) for index, (x, y) in enumerate(best) if all(y < before for _, before in best[:index])]
    series.append(Series("front, any number of sensors", [x for x, _ in hull], [y for _, y in hull], 5))
    says = "Mean error over the time after which a contact is known, a point per way to build the model"
    return standalone(draw(Chart(says, "known after, ms", "mean |error|, mm", series, log_x=True, log_y=True)))


def _sorted(points: Sequence[Point]) -> list[Point]:
    return sorted(points, key=lambda point: (point.sensors, point.filter.window, point.estimator, point.quantised))


def _table(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    return [
        "| " + " | ".join(headings) + " |",
        "|" + "---|" * len(headings),
        *("| " + " | ".join(cells) + " |" for cells in rows),
    ]
