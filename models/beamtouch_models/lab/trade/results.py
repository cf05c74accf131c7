"""The trade in sentences and tables, as JSON, and as four small charts on one axis of the error."""

import shlex
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from math import hypot
from typing import Any

from beamtouch_common.digits import digits
from beamtouch_common.units import fine_unit
from beamtouch_models.design.accuracy.statistics import Measurement
from beamtouch_models.design.charts import Chart, Series, Style, draw_row, standalone
from beamtouch_models.design.printing import Block, Table, Words
from beamtouch_models.lab.trade.measure import AnswerAtTime, MeasuredModel, Varied
from beamtouch_models.lab.trade.trade import Point, Trade, transfer_ms
from beamtouch_models.names import ESTIMATORS
from beamtouch_models.numbers import with_error

CHANGES: tuple[Varied, ...] = ("sensors", "noise", "latency")
"""Changes whose worth is told in a sentence each."""
MODEL_HEADINGS = (
    "changed", "sensors", "estimator", "noise", "readings", "error, mm", "over limit", "inference, µs",
)  # fmt: skip
MOMENT_HEADINGS = ("since touch, ms", "readings", "sudden touch, mm", "gentle touch, mm", "limit, mm")
POINT_HEADINGS = ("sensors", "estimator", "readings", "known after, ms", "error, mm")
MODEL, LIMIT, RINGING, OWN = "model", "accuracy limit", "while it rings", "the scene as stated"
ERROR = "mean |position error|, mm"


def _small(model: MeasuredModel) -> tuple[str, float]:
    """Return the unit of its noise for people, and how many of it are one of the scene's."""
    small, times = fine_unit(model.task.scene.unit)
    return small.replace("um", "µm"), times


def _noun(model: MeasuredModel) -> str:
    """Return the word for its structure."""
    return "plate" if model.task.scene.has_two_axes else "beam"


def blocks(trade: Trade, scene: str, seed: int, model: str) -> list[Block]:
    """Return the trade for people.

    Parameters
    ----------
    trade : a measured trade
    scene, seed : path of the scene, and the seed of the trade
    model : path of a model, for the commands that build one
    """
    own = trade.own
    commands = dict.fromkeys(
        _command(measured, scene, seed, model) for measured in (own, *(point.model for point in trade.front))
    )
    text = ("estimator",)
    headings = [f"{name}, {_small(own)[0]}" if name == "noise" else name for name in MODEL_HEADINGS]
    return [
        Words("\n".join(f"- {sentence}" for sentence in sentences(trade))),
        Table(headings, [_model_row(trade, measured) for measured in trade.models], "models", text),
        Words(
            "error: mean position error of a mean of so many readings at rest; over limit: over that of the best "
            "possible estimator, on the same contacts; ±: standard errors; inference: time that a program takes for "
            "an answer"
        ),
        Table(MOMENT_HEADINGS, [_answer_row(moment) for moment in trade.since_touch], "since a touch"),
        Words(
            f"Mean position error; a sudden touch makes the {_noun(own)} ring, a gentle one does not; limit: of the "
            "best possible estimator, after a gentle touch"
        ),
        Table(POINT_HEADINGS, [_point_row(point) for point in trade.front], "the front", text),
        Words(
            f"{len(trade.front)} of {len(trade.points)} points, those that no other one beats in error, time or number "
            "of sensors. Errors that differ by less than their standard error are equal, and times that differ by less "
            "than a reading period. A contact is known after its readings, the transfer of one at 1 Mbaud, and an "
            "inference."
        ),
        "To build them:",
        [(command,) for command in commands],
    ]


def sentences(trade: Trade) -> list[str]:
    """Return what each change of the scene is worth in the error, as a share of it with its standard error."""
    own = trade.own
    return [
        f"{own.sensors} sensors give a mean error of {_mm(own.reached.error_mm)} mm once the mean has settled; the "
        f"limit is {_mm(own.reached.limit_mm)} mm.",
        *(_worth(model, own) for varied in CHANGES for model in trade.varied(varied) if model is not own),
        *_time_in_words(trade),
        *_estimators_in_words(trade),
    ]


def _change(model: MeasuredModel, own: MeasuredModel) -> str:
    """Return in words what differs from the own model."""
    if model.task.varied == "latency":
        twice = "Twice the latency" if own.latency_ms else "A latency of two readings"
        return f"{twice} ({digits(model.latency_ms or 0.0, 3)} ms)"
    if model.task.varied == "noise":
        ratio = model.reading_mm / own.reading_mm
        words = {0.25: "A quarter of", 0.5: "Half", 2.0: "Twice", 4.0: "Four times"}
        return f"{words.get(round(ratio, 2), f'{digits(ratio, 2)} times')} the noise of a reading"
    more = model.sensors - own.sensors
    noun, way = "sensor" if abs(more) == 1 else "sensors", "more" if more > 0 else "fewer"
    return f"{abs(more)} {noun} {way} ({model.sensors})"


def _worth(model: MeasuredModel, own: MeasuredModel) -> str:
    """Return what a change saves or costs of the error of the own model."""
    change, ratio = _change(model, own), model.reached.error_mm.value / own.reached.error_mm.value
    scatter = ratio * hypot(
        *(error.standard_error / error.value for error in (model.reached.error_mm, own.reached.error_mm))
    )
    if abs(ratio - 1) <= scatter:
        return f"{change}: no difference beyond its standard error, {digits(100 * scatter, 1)} %."
    words = f"{digits(100 * abs(ratio - 1), 2)} ± {digits(100 * scatter, 1)} %"
    return f"{change}: {'saves' if ratio < 1 else 'costs'} {words} of the error."


def _time_in_words(trade: Trade) -> Iterator[str]:
    """Yield what waiting gives, and what the beam's ringing costs at the settled mean."""
    first, last, usual = trade.since_touch[0].answer, trade.since_touch[-1].answer, trade.usual.answer
    if usual.ringing_mm is not None:
        yield (
            f"While the {_noun(trade.own)} rings after a sudden force, the error is {_mm(usual.ringing_mm)} mm after "
            f"{digits(usual.since_ms, 3)} ms, instead of {_mm(usual.error_mm)} mm."
        )
    if last is not first:
        yield (
            f"The first answer comes {digits(first.since_ms, 3)} ms after a touch with {_mm(first.error_mm)} mm; after "
            f"{digits(last.since_ms, 3)} ms at rest the error is {_mm(last.error_mm)} mm."
        )


def _estimators_in_words(trade: Trade) -> Iterator[str]:
    for model in trade.varied("estimator"):
        if model is not trade.own:
            ours, theirs = (trade.time_of(measured).value for measured in (trade.own, model))
            ratio, own_ratio = (_ratio(measured.reached.ratio) for measured in (model, trade.own))
            yield (
                f"{model.task.estimator}: an inference takes {digits(theirs, 2)} µs instead of {digits(ours, 2)}, and "
                f"the error is {ratio} times the limit instead of {own_ratio}."
            )


def _command(point: MeasuredModel, scene: str, seed: int, model: str) -> str:
    """Return the command that builds a model of a scene."""
    words = ["design-sensors build", shlex.quote(scene), f"--sensors {point.sensors}"]
    words += [f"--estimator {point.task.estimator}"] if point.task.estimator != ESTIMATORS[0] else []
    words += [f"--seed {seed}"] if seed else []
    return " ".join([*words, f"-o {shlex.quote(model)}"])


def _model_row(trade: Trade, model: MeasuredModel) -> tuple[str, ...]:
    time = trade.time_of(model)
    return (
        "-" if model is trade.own else model.task.varied,
        str(model.sensors),
        model.task.estimator,
        digits(fine_unit(model.task.scene.unit)[1] * model.reading_mm, 3),
        str(model.filter.window),
        _mm(model.reached.error_mm),
        _ratio(model.reached.ratio),
        with_error(time.value, time.standard_error, "±"),
    )


def _answer_row(at_time: AnswerAtTime) -> tuple[str, ...]:
    answer = at_time.answer
    ringing = "-" if answer.ringing_mm is None else _mm(answer.ringing_mm)
    return digits(answer.since_ms, 4), str(answer.readings), ringing, _mm(answer.error_mm), _mm(at_time.limit_mm)


def _point_row(point: Point) -> tuple[str, ...]:
    estimator, known_ms = point.model.task.estimator, digits(point.latency_ms, 3)
    return str(point.model.sensors), estimator, str(point.readings), known_ms, _mm(point.error_mm)


def json_of(trade: Trade) -> dict[str, Any]:
    """Return the whole trade, for JSON."""
    return {
        "models": [_model_fields(trade, model) for model in trade.models],
        "points": [
            {
                "sensors": point.model.sensors,
                "estimator": point.model.task.estimator,
                "readings": point.readings,
                "error_mm": point.error_mm.value,
                "error_percent": asdict(point.error_mm.scaled(100 / point.model.length_mm)),
                "latency_ms": point.latency_ms,
                "on_front": point in trade.front,
            }
            for point in trade.points
        ],
        "failures": [asdict(failure) for failure in trade.failures],
        "since_touch": [asdict(moment.answer) | {"limit_mm": asdict(moment.limit_mm)} for moment in trade.since_touch],
        "sentences": sentences(trade),
    }


def _model_fields(trade: Trade, model: MeasuredModel) -> dict[str, Any]:
    percent = 100 / model.length_mm
    return {
        "changed": None if model is trade.own else model.task.varied,
        "sensors": model.sensors,
        "positions_mm": list(model.positions_mm),
        "estimator": model.task.estimator,
        "reading_mm": model.reading_mm,
        "filter": model.filter.model_dump(),
        "error_percent": asdict(model.reached.error_mm.scaled(percent)),
        "error_mm": model.reached.error_mm.value,
        "limit_percent": asdict(model.reached.limit_mm.scaled(percent)),
        "ratio": asdict(model.reached.ratio),
        "inference_us": asdict(trade.time_of(model)),
        "poll_ms": transfer_ms(model.sensors),
        "bytes": len(model.graph),
    }


def _mm(error: Measurement) -> str:
    return with_error(error.value, error.standard_error, "±")


def _ratio(ratio: Measurement) -> str:
    return with_error(ratio.value, ratio.standard_error, "±")


def picture(name: str, trade: Trade) -> str:
    """Return error over sensors, time since a touch, noise and time of an inference, with limits, as SVG."""
    says = (
        f"Mean position error of {name} with its standard error and its limit: over the number of sensors, the time "
        "since a touch, the noise of a reading, and the time of an inference"
    )
    sensors, noises, own = trade.varied("sensors"), trade.varied("noise"), trade.own
    small, times = _small(own)
    noises_um = [times * model.reading_mm for model in noises]
    charts = [
        _chart("sensors", [float(model.sensors) for model in sensors], sensors, own, log=False),
        _since_touch(trade),
        _chart(f"noise of a reading, {small}", noises_um, noises, own, log=True),
        _inference(trade),
    ]
    return standalone(draw_row(charts, says))


def _chart(label: str, x: Sequence[float], models: Sequence[MeasuredModel], own: MeasuredModel, *, log: bool) -> Chart:
    place = next(place for place, model in enumerate(models) if model is own)
    series = [
        _series(MODEL, x, [model.reached.error_mm for model in models], 0),
        _series(LIMIT, x, [model.reached.limit_mm for model in models], 1, "dashed"),
        Series(OWN, [x[place]], [own.reached.error_mm.value], style="ring"),
    ]
    ends = (x[0] - 0.5, x[-1] + 0.5) if not log else None
    return Chart(label, label, ERROR, series, log_x=log, log_y=True, whole_x=not log, x_range=ends)


def _since_touch(trade: Trade) -> Chart:
    moments, usual = trade.since_touch, trade.usual.answer
    x = [moment.answer.since_ms for moment in moments]
    series = [
        _series(MODEL, x, [moment.answer.error_mm for moment in moments], 0),
        _series(LIMIT, x, [moment.limit_mm for moment in moments], 1, "dashed"),
        Series(OWN, [usual.since_ms], [usual.error_mm.value], style="ring"),
    ]
    ringing = [moment.answer.ringing_mm for moment in moments if moment.answer.ringing_mm is not None]
    if ringing:
        series.insert(0, _series(RINGING, x, ringing, 2))
    return Chart("since touch", "since a touch, ms", ERROR, series, log_x=True, log_y=True)


def _inference(trade: Trade) -> Chart:
    models = trade.varied("estimator")
    times = [trade.time_of(model).value for model in models]
    series = [
        _series(model.task.estimator, [time], [model.reached.error_mm], 3 + place, "points")
        for place, (model, time) in enumerate(zip(models, times, strict=True))
    ]
    ends = min(times) / 1.5, max(times) * 1.5
    series.append(_series(LIMIT, ends, [trade.own.reached.limit_mm] * 2, 1, "dashed"))
    place = models.index(trade.own)
    series.append(Series(OWN, [times[place]], [trade.own.reached.error_mm.value], style="ring"))
    return Chart("inference", "an inference, µs", ERROR, series, log_x=True, log_y=True, x_range=ends)


def _series(
    label: str, x: Sequence[float], errors: Sequence[Measurement], colour: int, style: Style = "line"
) -> Series:
    bars = [error.standard_error for error in errors]
    return Series(label, x, [error.value for error in errors], colour, style, errors=bars)
