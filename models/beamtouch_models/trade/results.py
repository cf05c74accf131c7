"""The trade in sentences, in tables, as JSON, and as four small charts on one axis of the error."""

from collections.abc import Iterator, Sequence
from dataclasses import asdict
from math import hypot
from typing import Any

from beamtouch_common.digits import digits
from beamtouch_common.table import aligned_markdown
from beamtouch_models.accuracy.statistics import Measurement
from beamtouch_models.charts import Chart, Series, Style, draw_row, standalone
from beamtouch_models.estimators.estimator import NAMES
from beamtouch_models.trade.measure import Model
from beamtouch_models.trade.trade import Point, Trade, transfer_ms

MODEL_HEADINGS = (
    "changed", "sensors", "estimator", "noise, µm", "readings", "error, mm", "limit, mm", "over limit",
    "p50, µs", "p99, µs", "kB",
)  # fmt: skip
POINT_HEADINGS = ("front", "sensors", "estimator", "readings", "known after, ms", "error, mm")
CURVE_HEADINGS = ("since touch, ms", "readings", "error, mm", "while the beam rings, mm", "limit, mm")


def sentences(trade: Trade) -> list[str]:
    """Return what each change of the scene is worth in the error, as a share of it with its standard error."""
    own = trade.own
    return [
        f"{own.sensors} sensors give a mean error of {_mm(own.error_mm)} mm once the mean has settled; the limit is "
        f"{_mm(own.limit_mm)} mm.",
        *(_worth(_sensors_in_words(model, own), model, own) for model in trade.varied("sensors") if model is not own),
        *(_worth(_noise_in_words(model, own), model, own) for model in trade.varied("noise") if model is not own),
        *(_worth(_latency_in_words(model, own), model, own) for model in trade.varied("latency") if model is not own),
        *_time_in_words(trade),
        *_estimators_in_words(trade),
    ]


def _sensors_in_words(model: Model, own: Model) -> str:
    more = model.sensors - own.sensors
    noun, way = "sensor" if abs(more) == 1 else "sensors", "more" if more > 0 else "fewer"
    return f"{abs(more)} {noun} {way} ({model.sensors})"


def _noise_in_words(model: Model, own: Model) -> str:
    ratio = model.reading_mm / own.reading_mm
    words = {0.25: "a quarter of", 0.5: "half", 2.0: "twice", 4.0: "four times"}
    return f"{words.get(round(ratio, 2), f'{digits(ratio, 2)} times')} the noise of a reading"


def _latency_in_words(model: Model, own: Model) -> str:
    twice = "twice the latency" if own.latency_ms else "a latency of two readings"
    return f"{twice} ({digits(model.latency_ms or 0.0, 3)} ms)"


def _worth(change: str, model: Model, own: Model) -> str:
    """Return what a change saves or costs of the error of the own model."""
    ratio = model.error_mm.value / own.error_mm.value
    scatter = ratio * hypot(*(one.error_mm.standard_error / one.error_mm.value for one in (model, own)))
    change = change[0].upper() + change[1:]
    if abs(ratio - 1) <= scatter:
        return f"{change}: no difference beyond its standard error, {digits(100 * scatter, 1)} %."
    words = f"{digits(100 * abs(ratio - 1), 2)} ± {digits(100 * scatter, 1)} %"
    return f"{change}: {'saves' if ratio < 1 else 'costs'} {words} of the error."


def _time_in_words(trade: Trade) -> Iterator[str]:
    """Yield what waiting gives, and what the beam's ringing costs at the settled mean."""
    curve, window = trade.curve, trade.own.filter.window
    place = curve.readings.index(window)
    if len(curve.readings) > 1:
        first, last = curve.error_mm[0], curve.error_mm[-1]
        yield (
            f"The first answer comes {digits(curve.since_ms[0], 3)} ms after a touch with {_mm(first)} mm; after "
            f"{digits(curve.since_ms[-1], 3)} ms at rest the error is {_mm(last)} mm."
        )
    if curve.ringing_mm:
        yield (
            f"While the beam rings after a sudden force, the error is {_mm(curve.ringing_mm[place])} mm after "
            f"{digits(curve.since_ms[place], 3)} ms, instead of {_mm(curve.error_mm[place])} mm."
        )


def _estimators_in_words(trade: Trade) -> Iterator[str]:
    for model in trade.varied("estimator"):
        if model is not trade.own:
            ours, theirs = (trade.time_of(one).p50_us for one in (trade.own, model))
            yield (
                f"{model.estimator}: an inference takes {digits(theirs, 2)} µs instead of {digits(ours, 2)}, and the "
                f"error is {_ratio(model.ratio)} times the limit instead of {_ratio(trade.own.ratio)}."
            )


def command_of(point: Model, scene: str, seed: int, model: str) -> str:
    """Return the command that builds a model of a scene."""
    words = ["design-sensors build", scene, f"--sensors {point.sensors}"]
    words += [f"--estimator {point.estimator}"] if point.estimator != NAMES[0] else []
    words += [f"--seed {seed}"] if seed else []
    return " ".join([*words, f"-o {model}"])


def point_row(point: Point, *, on_front: bool) -> tuple[str, ...]:
    """Return a point as the cells of a row under `POINT_HEADINGS`."""
    return (
        "*" if on_front else "",
        str(point.model.sensors),
        point.model.estimator,
        str(point.readings),
        digits(point.latency_ms, 3),
        _mm(point.error_mm),
    )


def _model_row(trade: Trade, model: Model) -> tuple[str, ...]:
    times = trade.time_of(model)
    return (
        "-" if model is trade.own else model.varied,
        str(model.sensors),
        model.estimator,
        digits(1e3 * model.reading_mm, 3),
        str(model.filter.window),
        _mm(model.error_mm),
        _mm(model.limit_mm),
        _ratio(model.ratio),
        f"{digits(times.p50_us, 3)} ± {digits(times.p50_standard_error_us, 1)}",
        digits(times.p99_us, 3),
        digits(len(model.graph) / 1e3, 3),
    )


def _curve_rows(trade: Trade) -> list[tuple[str, ...]]:
    curve = trade.curve
    ringing = [_mm(one) for one in curve.ringing_mm] or ["-"] * len(curve.readings)
    return [
        (digits(since_ms, 4), str(readings), _mm(error), rings, _mm(limit))
        for since_ms, readings, error, rings, limit in zip(
            curve.since_ms, curve.readings, curve.error_mm, ringing, curve.limit_mm, strict=True
        )
    ]


_ABOUT_MODELS = """\
What `build` makes of the scene, and of the scene with one thing changed. The error is that of a mean of `readings`
readings at rest, the limit that of the best possible estimator on the same contacts."""
_ABOUT_CURVE = "The scene's own model behind the filter that `build` writes."
_ABOUT_POINTS = """\
The answers of the models that need no change of the scene. A point is on the front (*) if no other one is better in one
of error, time and number of sensors and worse in none. Errors that differ by less than their standard error are equal,
and times that differ by less than a reading period.
A contact is known after its readings, the transfer of one at 1 Mbaud, and an inference."""


def markdown(name: str, trade: Trade, scene: str, seed: int) -> str:
    """Return the whole trade as Markdown, with the picture `trade.svg` in it."""
    commands = dict.fromkeys(command_of(point.model, scene, seed, f"{name}.onnx") for point in trade.front)
    points = sorted(trade.points, key=lambda point: (point.model.sensors, point.model.estimator, point.readings))
    parts = [
        f"# Accuracy against speed: {name}",
        "![error over sensors, time, noise and inference](trade.svg)",
        "\n".join(f"- {sentence}" for sentence in sentences(trade)),
        "\n".join(f"- Failed: {failure}" for failure in trade.failures),
        "## Models",
        _ABOUT_MODELS,
        aligned_markdown(MODEL_HEADINGS, [_model_row(trade, model) for model in trade.models]),
        "## Since a touch",
        _ABOUT_CURVE,
        aligned_markdown(CURVE_HEADINGS, _curve_rows(trade)),
        "## Points",
        _ABOUT_POINTS,
        aligned_markdown(POINT_HEADINGS, [point_row(one, on_front=one in trade.front) for one in points]),
        "## Commands",
        "\n".join(["```", *commands, "```"]),
    ]
    return "\n\n".join(part for part in parts if part) + "\n"


def json_of(trade: Trade) -> dict[str, Any]:
    """Return the whole trade, for JSON."""
    return {
        "planned_points": len(trade.models) + len(trade.failures),
        "models": [_model_fields(trade, model) for model in trade.models],
        "points": [
            {
                "sensors": point.model.sensors,
                "estimator": point.model.estimator,
                "readings": point.readings,
                "error_mm": point.error_mm.value,
                "error_percent": asdict(point.error_mm.scaled(100 / point.model.length_mm)),
                "latency_ms": point.latency_ms,
                "on_front": point in trade.front,
            }
            for point in trade.points
        ],
        "failures": [asdict(failure) for failure in trade.failures],
        "since_touch": asdict(trade.curve),
        "sentences": sentences(trade),
    }


def _model_fields(trade: Trade, model: Model) -> dict[str, Any]:
    percent = 100 / model.length_mm
    return {
        "changed": None if model is trade.own else model.varied,
        "sensors": model.sensors,
        "positions_mm": list(model.positions_mm),
        "estimator": model.estimator,
        "reading_mm": model.reading_mm,
        "filter": model.filter.model_dump(),
        "error_percent": asdict(model.error_mm.scaled(percent)),
        "error_mm": model.error_mm.value,
        "limit_percent": asdict(model.limit_mm.scaled(percent)),
        "ratio": asdict(model.ratio),
        "times": asdict(trade.time_of(model)),
        "poll_ms": transfer_ms(model.sensors),
        "bytes": len(model.graph),
    }


def _mm(error: Measurement) -> str:
    return f"{digits(error.value, 3)} ± {digits(error.standard_error, 1)}"


def _ratio(ratio: Measurement) -> str:
    return f"{ratio.value:.3f} ± {digits(ratio.standard_error, 1)}"


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
