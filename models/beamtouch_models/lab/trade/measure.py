"""The models of a trade: those that `build` makes of a scene by default, and of the scene with one thing changed."""

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from beamtouch_models.design.accuracy.limit import Reached, accuracy_limit
from beamtouch_models.design.accuracy.statistics import Measurement
from beamtouch_models.design.building.measure import reach
from beamtouch_models.design.building.since_touch import Answer, answers_of_means, answers_since_touch
from beamtouch_models.design.effort import USUAL, Effort
from beamtouch_models.design.estimators.onnx_graph import to_bytes
from beamtouch_models.design.layout import keep_sensors, place_sensors
from beamtouch_models.design.placement.placing import DEFAULT_AIM, Aim
from beamtouch_models.design.scene import Scene, change_scene
from beamtouch_models.design.scene.tables import MIN_SENSORS
from beamtouch_models.design.surface import resolve
from beamtouch_models.errors import NotGoodEnoughError, SceneError
from beamtouch_models.names import ESTIMATORS, EstimatorName
from beamtouch_models.places import Place
from beamtouch_models.runtime.metadata import INPUTS
from beamtouch_models.runtime.metadata_parts import FilterChoice
from beamtouch_models.runtime.session import open_session, runner

AROUND = 2
"""If the scene states a number of sensors, fewer ones down to AROUND less are measured, and one more."""
NOISES = (0.25, 0.5, 2.0, 4.0)
"""Noises of a reading that are measured, over that of the scene."""
ROUNDS, CALLS = 40, 50
"""Usual number of rounds in which inferences are timed, and inferences of each model in a round."""

Varied = Literal["sensors", "estimator", "noise", "latency"]
"""The one thing that differs from the model that `build` makes of the scene; "sensors" also of that model itself."""


@dataclass(frozen=True)
class Task:
    """A model to measure, as plain data that can be sent to a worker."""

    scene: Scene
    """The scene as stated, or with the changed noise or latency."""
    varied: Varied
    sensors: int
    draws: int
    seed: int
    estimator: EstimatorName = ESTIMATORS[0]
    kept_mm: tuple[Place, ...] = ()
    """A layout that is placed already; none: the sensors are placed as `build` places them."""
    effort: Effort = USUAL

    @property
    def aim(self) -> Aim:
        """The aim of its layout."""
        return replace(DEFAULT_AIM, effort=self.effort)


@dataclass(frozen=True, eq=False)
class MeasuredModel:
    """A measured model, not timed yet."""

    task: Task
    positions_mm: tuple[Place, ...]
    reading_mm: float
    """Noise of a reading."""
    filter: FilterChoice
    length_mm: float
    reached: Reached
    """For a mean of `filter.window` readings at rest, as `build` states it."""
    answers: tuple[Answer, ...]
    """For plain means of the readings of a touch."""
    graph: bytes

    @property
    def sensors(self) -> int:
        """The number of sensors."""
        return len(self.positions_mm)

    @property
    def latency_ms(self) -> float | None:
        """The latency that the scene, or the changed one, states."""
        return self.task.scene.requirements.latency_ms


@dataclass(frozen=True)
class Failure:
    """A model that cannot be built, with the reason."""

    varied: Varied
    sensors: int
    estimator: EstimatorName
    reason: str

    def __str__(self) -> str:
        """Return the failure in words."""
        return f"{self.sensors} sensors, {self.estimator}, another {self.varied}: {self.reason}"


@dataclass(frozen=True)
class AnswerAtTime:
    """The answer of the scene's own model at a time since a touch, behind the filter that `build` writes."""

    answer: Answer
    limit_mm: Measurement
    """Accuracy limit for the mean of all its readings, on a structure at rest."""


def numbers_of_sensors(scene: Scene) -> list[int]:
    """Return the numbers of sensors to measure: the scene's range, or numbers around the one that it states."""
    count, most = scene.count_range
    fewest = scene.fewest
    if count == most:
        # On a plane, one or two sensors leave a curve of places: a contact has three unknowns.
        least = MIN_SENSORS + (2 if scene.has_two_axes else 1)
        around = max(least, count - AROUND, len(scene.sensors.fixed_mm) + len(scene.sensors.fixed))
        fewest, most = min(count, around), count + 1
        if scene.measured is not None:
            most = min(most, len(scene.measured.loads.names))
    return list(range(fewest, most + 1))


def with_noises(scene: Scene) -> list[Scene]:
    """Return the scene with each other noise of its sensors; none if its noise comes from the ADC alone."""
    noise_mm = resolve(scene).readings.sensor_mm
    if noise_mm == 0:
        return []
    return [
        change_scene(scene, sensors={"noise_mm": noise_mm * factor, "noise_percent_of_max": None}) for factor in NOISES
    ]


def with_twice_the_latency(scene: Scene) -> Scene:
    """Return the scene with twice its latency; without one, with that of two readings."""
    latency_ms = scene.requirements.latency_ms or 1e3 / scene.sensors.rate_hz
    return change_scene(scene, requirements={"latency_ms": 2 * latency_ms})


def measure(task: Task) -> MeasuredModel | Failure:
    """Place the sensors of a model, make its estimator, and measure it on the contacts on which `build` measures it.

    A scene of which nothing can be built is returned as a failure.
    """
    seed = task.seed
    try:
        surface = resolve(task.scene)
        if task.kept_mm:
            layout = keep_sensors(surface, task.kept_mm, task.aim)
        else:
            layout = place_sensors(surface, count=task.sensors, seed=seed, aim=task.aim)
        prior, made = layout.prior, layout.make_estimator(task.estimator, seed)
        graph = to_bytes(made.graph)
        run = runner(graph)
        reached = reach(made, prior, run, task.draws, seed + 2, task.scene)
    except (SceneError, NotGoodEnoughError) as error:
        return Failure(task.varied, task.sensors, task.estimator, str(error))
    return MeasuredModel(
        task,
        tuple(layout.placement.places),
        surface.noise.reading_mm,
        surface.filter,
        prior.diagonal_mm,
        reached,
        tuple(answers_of_means(prior, run, surface, layout.world, reached.error_mm, seed + 2, task.effort)),
        graph,
    )


def follow(model: MeasuredModel) -> list[AnswerAtTime]:
    """Return the answers of a model by the time since a touch."""
    task, seed = model.task, model.task.seed + 2
    layout = keep_sensors(resolve(task.scene, chosen=model.filter), model.positions_mm)
    prior, run = layout.prior, runner(model.graph)
    moments = []
    for answer in answers_since_touch(model.answers, prior, run, layout.surface, layout.world, seed, task.effort):
        noise_mm = model.reading_mm / math.sqrt(answer.readings)
        limit = accuracy_limit(prior.at_noise(noise_mm), task.draws, seed)
        limit_mm = limit.scaled(model.length_mm / 100)
        moments.append(AnswerAtTime(answer, limit_mm))
    return moments


def inference_times(models: Sequence[MeasuredModel]) -> list[Measurement]:
    """Return the median time of an inference of a single sample in µs, with the standard error of the rounds.

    A graph takes as long at rest as for a contact: it computes the same.
    """
    runs = []
    for model in models:
        at_rest = np.zeros((1, model.sensors), np.float32), np.eye(model.sensors, dtype=np.float32)[None]
        runs.append((open_session(model.graph), dict(zip(INPUTS, at_rest, strict=True))))
    rounds = models[0].task.effort.of(ROUNDS)
    times = np.empty((len(runs), rounds, CALLS))
    for turn in range(rounds):
        for (session, feed), taken in zip(runs, times[:, turn], strict=True):
            for call in range(CALLS):
                start = time.perf_counter_ns()
                session.run(None, feed)
                taken[call] = (time.perf_counter_ns() - start) / 1e3
    return [
        Measurement(float(np.median(times_us)), float(np.median(times_us, axis=1).std(ddof=1) / rounds**0.5))
        for times_us in times
    ]
