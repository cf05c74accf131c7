"""The trade of a scene: the models around the one that `build` makes by default, their answers, and their front."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from math import hypot

from beamtouch_common.digits import digits
from beamtouch_common.errors import InputError
from beamtouch_models.design.accuracy.statistics import Measurement
from beamtouch_models.design.building.since_touch import Answer
from beamtouch_models.design.effort import USUAL, Effort
from beamtouch_models.design.scene import Scene
from beamtouch_models.design.surface import resolve
from beamtouch_models.design.sweeps import Progress, TaskMap
from beamtouch_models.errors import SceneError
from beamtouch_models.lab.trade.measure import (
    AnswerAtTime,
    Failure,
    MeasuredModel,
    Task,
    Varied,
    follow,
    inference_times,
    measure,
    numbers_of_sensors,
    with_noises,
    with_twice_the_latency,
)
from beamtouch_models.names import ESTIMATORS, EstimatorName

SERIAL_BAUD, FRAME_BYTES, BYTE_BITS = 1_000_000, 13, 10
"""Transfer of a reading by PROTOCOL.md: FRAME_BYTES and two bytes per channel, of ten bits each."""


class UnreachableTargetError(InputError):
    """No point of the trade meets the requirement."""


@dataclass(frozen=True)
class Point:
    """A model that `build` makes of the scene, and one time at which it answers."""

    model: MeasuredModel
    readings: int
    error_mm: Measurement
    """Mean |position error| of the answer on a structure that follows a touch at once."""
    latency_ms: float
    """Time from a touch to the answer: these readings, the transfer of one, and an inference."""
    periods: int
    """The same in reading periods. A touch comes at any time within one, so a fraction of it is no difference."""


def transfer_ms(sensors: int) -> float:
    """Return the time in which a reading comes over a serial line, in ms."""
    return (FRAME_BYTES + 2 * sensors) * BYTE_BITS / SERIAL_BAUD * 1e3


def _point(model: MeasuredModel, answer: Answer, inference_us: float) -> Point:
    latency_ms = answer.since_ms + transfer_ms(model.sensors) + inference_us / 1e3
    periods = round(latency_ms / answer.since_ms * answer.readings)
    return Point(model, answer.readings, answer.error_mm, latency_ms, periods)


def pareto_front(points: Sequence[Point]) -> list[Point]:
    """Return the points that no other one beats in time, error and number of sensors; fewest sensors and fastest first.

    Errors differ if they do so by more than the standard error of their difference, and times by a reading period.
    """
    return sorted(
        (point for point in points if not any(_beats(rival, point) for rival in points)),
        key=lambda point: (point.model.sensors, point.latency_ms),
    )


def is_smaller(one: Measurement, other: Measurement) -> bool:
    """Return whether one error is smaller than another by more than the standard error of their difference."""
    return one.value < other.value - hypot(one.standard_error, other.standard_error)


def _beats(one: Point, other: Point) -> bool:
    """Return whether a point is better in one respect and worse in none."""
    ours, theirs = ((point.model.sensors, point.periods) for point in (one, other))
    if any(a > b for a, b in zip(ours, theirs, strict=True)) or is_smaller(other.error_mm, one.error_mm):
        return False
    return ours != theirs or is_smaller(one.error_mm, other.error_mm)


def most_accurate(points: Sequence[Point], latency_ms: float) -> Point:
    """Return the point with the smallest error within a latency; otherwise UnreachableTargetError names the nearest."""
    quick = [point for point in points if point.latency_ms <= latency_ms]
    if not quick:
        nearest_ms = min(point.latency_ms for point in points)
        raise UnreachableTargetError(
            f"no point answers within {latency_ms:g} ms; the fastest takes {digits(nearest_ms, 3)} ms; raise "
            "sensors.rate_hz"
        )
    return min(quick, key=lambda point: (point.error_mm.value, point.latency_ms))


def quickest(points: Sequence[Point], error_mm: float) -> Point:
    """Return the fastest point within an error, ties by sensors; otherwise UnreachableTargetError names the nearest."""
    accurate = [point for point in points if point.error_mm.value <= error_mm]
    if not accurate:
        nearest_mm = min(point.error_mm.value for point in points)
        raise UnreachableTargetError(
            f"no point has a mean error of {error_mm:g} mm; the best has {digits(nearest_mm, 3)} mm; allow more "
            "sensors or a larger requirements.max_mean_ms, or use sensors with less noise"
        )
    return min(accurate, key=lambda point: (point.periods, point.model.sensors, point.latency_ms))


@dataclass(frozen=True, eq=False)
class Trade:
    """The measured models of a scene, with the figures that a buyer compares."""

    own: MeasuredModel
    """The model that `build` makes of the scene."""
    models: tuple[MeasuredModel, ...]
    """All models, the own one among them."""
    inference_us: tuple[Measurement, ...]
    """Median time of an inference of a single sample, per model."""
    failures: tuple[Failure, ...]
    since_touch: tuple[AnswerAtTime, ...]
    """The answers of the own model by the time since a touch."""
    points: tuple[Point, ...]
    """The answers of the models that `build` makes of the scene without a change in it."""
    front: tuple[Point, ...]

    @property
    def usual(self) -> AnswerAtTime:
        """The answer for the mean that layout and thresholds are chosen for."""
        return next(moment for moment in self.since_touch if moment.answer.readings == self.own.filter.window)

    def varied(self, varied: Varied) -> list[MeasuredModel]:
        """Return the models in which one thing differs, with the own one, in order of this thing or as they came."""
        models = [model for model in self.models if model is self.own or model.task.varied == varied]
        if varied == "noise":
            return sorted(models, key=lambda model: model.reading_mm)
        return models

    def time_of(self, model: MeasuredModel) -> Measurement:
        """Return the median time of an inference of a model, in µs."""
        return self.inference_us[self.models.index(model)]


def trade(
    scene: Scene,
    estimators: Sequence[EstimatorName],
    *,
    draws: int,
    seed: int,
    spread: TaskMap,
    progress: Progress,
    effort: Effort = USUAL,
) -> Trade:
    """Measure the models of a scene: other numbers of sensors, estimators and noises, and twice the latency.

    The own model has the number of sensors that the scene states. If the scene leaves it open, it has the fewest
    sensors whose accuracy limit meets its requirement, or the most that can be placed. Inferences are timed at the
    end, when the workers have nothing to do.

    Raises
    ------
    SceneError
        No model of the scene can be built.
    """
    resolve(scene).check()
    counts = numbers_of_sensors(scene)
    planned = len(counts) + len(estimators) + len(with_noises(scene)) + 2
    done: list[MeasuredModel | Failure] = []

    def measured(tasks: Iterable[Task]) -> Iterator[MeasuredModel | Failure]:
        for result in spread(measure, tasks):
            done.append(result)
            progress("measuring models", len(done) / planned)
            yield result

    tried = list(measured(Task(scene, "sensors", count, draws, seed, effort=effort) for count in counts))
    placed = [result for result in tried if isinstance(result, MeasuredModel)]
    if not placed:
        raise SceneError(next(result.reason for result in tried if isinstance(result, Failure)))
    own = _own_of(scene, placed)
    kept_mm, variations = own.positions_mm, list[Task]()
    variations += [
        Task(scene, "estimator", own.sensors, draws, seed, name, kept_mm, effort)
        for name in estimators
        if name != ESTIMATORS[0]
    ]
    variations += [Task(variant, "noise", own.sensors, draws, seed, effort=effort) for variant in with_noises(scene)]
    variations += [Task(with_twice_the_latency(scene), "latency", own.sensors, draws, seed, effort=effort)]
    tried += measured(variations)
    progress("following touches", (planned - 1) / planned)
    (moments,) = spread(follow, [own])
    models = tuple(result for result in tried if isinstance(result, MeasuredModel))
    times = tuple(inference_times(models))
    points = [
        _point(model, answer, time.value)
        for model, time in zip(models, times, strict=True)
        if model.task.varied in ("sensors", "estimator")
        for answer in model.answers
    ]
    failures = tuple(result for result in tried if isinstance(result, Failure))
    return Trade(own, models, times, failures, tuple(moments), tuple(points), tuple(pareto_front(points)))


def _own_of(scene: Scene, models: Sequence[MeasuredModel]) -> MeasuredModel:
    """Return the model that `build` makes, of models with different numbers of sensors."""
    count, most = scene.count_range
    if count == most:
        return next((model for model in models if model.sensors == count), models[-1])
    wanted_mm = scene.requirements.position_error_mm
    enough = (model for model in models if wanted_mm is not None and model.reached.limit_mm.value <= wanted_mm)
    return next(enough, models[-1])
