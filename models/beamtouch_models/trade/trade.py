"""The trade of a scene: its models measured around the one that `build` makes by default."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

from beamtouch_models.errors import SceneError
from beamtouch_models.estimators.estimator import NAMES, Name
from beamtouch_models.progress import Progress
from beamtouch_models.scene import Scene
from beamtouch_models.surface import Surface
from beamtouch_models.sweeps import Spread
from beamtouch_models.trade.front import Point, pareto_front, points_of
from beamtouch_models.trade.measure import (
    Curve,
    Failure,
    Model,
    Task,
    Varied,
    follow,
    measure,
    numbers_of_sensors,
    with_noises,
    with_twice_the_latency,
)
from beamtouch_models.trade.timing import Times, inference_times


@dataclass(frozen=True, eq=False)
class Trade:
    """The measured models of a scene, with the figures that a buyer compares."""

    own: Model
    """The model that `build` makes of the scene."""
    models: tuple[Model, ...]
    """All models, the own one among them."""
    times: tuple[Times, ...]
    """Of an inference, per model."""
    failures: tuple[Failure, ...]
    curve: Curve
    points: tuple[Point, ...]
    """The answers of the models that `build` makes of the scene without a change in it."""
    front: tuple[Point, ...]

    def varied(self, varied: Varied) -> list[Model]:
        """Return the models in which one thing differs, with the own one, in order of this thing or as they came."""
        found = [model for model in self.models if model is self.own or model.varied == varied]
        if varied == "noise":
            return sorted(found, key=lambda model: model.reading_mm)
        return found

    def time_of(self, model: Model) -> Times:
        """Return the times of an inference of a model."""
        return self.times[self.models.index(model)]


def trade(
    scene: Scene, estimators: Sequence[Name], *, draws: int, seed: int, spread: Spread, progress: Progress
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
    Surface.of(scene).check()
    counts = numbers_of_sensors(scene)
    planned = len(counts) + len(estimators) + len(with_noises(scene)) + 2
    done: list[Model | Failure] = []

    def measured(tasks: Iterable[Task]) -> Iterator[Model | Failure]:
        for one in spread(measure, tasks):
            done.append(one)
            progress("measuring models", len(done) / planned)
            yield one

    tried = list(measured(Task(scene, "sensors", count, draws, seed) for count in counts))
    placed = [one for one in tried if isinstance(one, Model)]
    if not placed:
        raise SceneError(next(one.reason for one in tried if isinstance(one, Failure)))
    own = _own_of(scene, placed)
    kept_mm, variations = own.positions_mm, list[Task]()
    variations += [
        Task(scene, "estimator", own.sensors, draws, seed, name, kept_mm) for name in estimators if name != NAMES[0]
    ]
    variations += [Task(other, "noise", own.sensors, draws, seed) for other in with_noises(scene)]
    variations += [Task(with_twice_the_latency(scene), "latency", own.sensors, draws, seed)]
    tried += measured(variations)
    progress("following touches", (planned - 1) / planned)
    (curve,) = spread(follow, [(scene, own, draws, seed)])
    models = tuple(one for one in tried if isinstance(one, Model))
    times = tuple(inference_times([(one.graph, one.deflection_mm, one.whitening_per_mm) for one in models]))
    points = [
        point
        for model, time in zip(models, times, strict=True)
        if model.varied in ("sensors", "estimator")
        for point in points_of(model, time)
    ]
    failures = tuple(one for one in tried if isinstance(one, Failure))
    return Trade(own, models, times, failures, curve, tuple(points), tuple(pareto_front(points)))


def _own_of(scene: Scene, models: Sequence[Model]) -> Model:
    """Return the model that `build` makes, of models with different numbers of sensors."""
    stated, most = scene.sensors.count_range
    if stated == most:
        return next((model for model in models if model.sensors == stated), models[-1])
    wanted_mm = scene.requirements.position_error_mm
    enough = (model for model in models if wanted_mm is not None and model.limit_mm.value <= wanted_mm)
    return next(enough, models[-1])
