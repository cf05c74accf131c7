"""The trade as four small charts on one axis of the error."""

from collections.abc import Sequence

from beamtouch_models.accuracy.statistics import Measurement
from beamtouch_models.charts import Chart, Series, Style, draw_row, standalone
from beamtouch_models.trade.measure import Model
from beamtouch_models.trade.trade import Trade

MODEL, LIMIT, RINGING, OWN = "model", "accuracy limit", "while the beam rings", "the scene as stated"
ERROR = "mean |position error|, mm"


def picture(name: str, trade: Trade) -> str:
    """Return error over sensors, time since a touch, noise and time of an inference, with limits, as SVG."""
    says = (
        f"Mean position error of {name} with its standard error and its limit: over the number of sensors, the time "
        "since a touch, the noise of a reading, and the time of an inference"
    )
    charts = [_sensors(trade), _since_touch(trade), _noise(trade), _inference(trade)]
    return standalone(draw_row(charts, says))


def _sensors(trade: Trade) -> Chart:
    models = trade.varied("sensors")
    x = [float(model.sensors) for model in models]
    return _chart("sensors", x, models, trade.own, log=False)


def _noise(trade: Trade) -> Chart:
    models = trade.varied("noise")
    return _chart("noise of a reading, µm", [1e3 * model.reading_mm for model in models], models, trade.own, log=True)


def _chart(label: str, x: Sequence[float], models: Sequence[Model], own: Model, *, log: bool) -> Chart:
    place = next(place for place, model in enumerate(models) if model is own)
    series = [
        _series(MODEL, x, [model.error_mm for model in models], 0),
        _series(LIMIT, x, [model.limit_mm for model in models], 1, "dashed"),
        Series(OWN, [x[place]], [own.error_mm.value], style="ring"),
    ]
    ends = (x[0] - 0.5, x[-1] + 0.5) if not log else None
    return Chart(label, label, ERROR, series, log_x=log, log_y=True, whole_x=not log, x_range=ends)


def _since_touch(trade: Trade) -> Chart:
    curve = trade.curve
    x = curve.since_ms
    series = [_series(MODEL, x, curve.error_mm, 0), _series(LIMIT, x, curve.limit_mm, 1, "dashed")]
    if curve.ringing_mm:
        series.append(_series(RINGING, x, curve.ringing_mm, 2))
    place = curve.readings.index(trade.own.filter.window)
    series.append(Series(OWN, [x[place]], [curve.error_mm[place].value], style="ring"))
    return Chart("since touch", "since a touch, ms", ERROR, series, log_x=True, log_y=True)


def _inference(trade: Trade) -> Chart:
    models = trade.varied("estimator")
    times = [trade.time_of(model).p50_us for model in models]
    series = [
        _series(model.estimator, [time], [model.error_mm], 3 + place, "points")
        for place, (model, time) in enumerate(zip(models, times, strict=True))
    ]
    ends = min(times) / 1.5, max(times) * 1.5
    series.append(_series(LIMIT, ends, [trade.own.limit_mm] * 2, 1, "dashed"))
    place = models.index(trade.own)
    series.append(Series(OWN, [times[place]], [trade.own.error_mm.value], style="ring"))
    return Chart("inference", "an inference, µs", ERROR, series, log_x=True, log_y=True, x_range=ends)


def _series(
    label: str, x: Sequence[float], errors: Sequence[Measurement], colour: int, style: Style = "line"
) -> Series:
    bars = [error.standard_error for error in errors]
    return Series(label, x, [error.value for error in errors], colour, style, errors=bars)
