"""The trade as plots."""

from collections.abc import Sequence

from beamtouch_models.accuracy.statistics import Measurement
from beamtouch_models.charts import Chart, Series, Style, draw
from beamtouch_models.svg import standalone
from beamtouch_models.trade.point import Point
from beamtouch_models.trade.since_touch import Curve

FRONT_COLOUR = 7
"""The colours before it belong to three estimators in two precisions."""


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
