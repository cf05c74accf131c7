"""The points of the trade: estimator, sensors, filter, precision; each with its error and what it costs."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import onnx
from numpy.typing import NDArray

from beamtouch_models import limit
from beamtouch_models.beam import check_small_angles
from beamtouch_models.effects import required
from beamtouch_models.errors import SceneError
from beamtouch_models.estimators.estimator import Estimator, Name, estimator_of
from beamtouch_models.estimators.running import runner
from beamtouch_models.evaluation import Figure, mean_of, ratio_of
from beamtouch_models.export import to_bytes
from beamtouch_models.modelfile import FilterChoice
from beamtouch_models.noise import noise_of, reading_noise_mm, window_filter
from beamtouch_models.placement import fewest_sensors
from beamtouch_models.prior import Prior
from beamtouch_models.scene import MIN_SENSORS, Scene
from beamtouch_models.trade.quantised import quantised
from beamtouch_models.trade.timing import Times, inference_times

Array = NDArray[np.float64]
Progress = Callable[[str, float], None]

WINDOWS = (1, 2, 4, 8, 16)
LONGEST_MS = 100.0
"""Of a filter, where the scene states no latency."""
AROUND = 2
"""How many sensors fewer, and one less how many more, than the scene states."""
SERIAL_BAUD, FRAME_BYTES, BYTE_BITS = 1_000_000, 13, 10
"""A reading on the serial line of PROTOCOL.md: so many bytes and two per channel, of ten bits each."""


@dataclass(frozen=True)
class Point:
    """One way to build the model of a scene."""

    estimator: Name
    sensors: int
    filter: FilterChoice
    quantised: bool
    error_percent: Figure
    """Mean |position error|, of the length."""
    error_mm: float
    limit_percent: Figure
    """Of this layout and filter, on the same contacts."""
    ratio: Figure
    times: Times
    poll_ms: float
    """From the instant of a reading until the daemon has it."""
    bytes: int
    latency_ms: float
    """From a touch to the first answer that knows only it: half a period on average, poll, filter, inference."""


@dataclass(frozen=True)
class _Made:
    estimator: Estimator
    filter: FilterChoice
    prior: Prior
    quantised: bool
    error_mm: Array
    best_mm: Array

    @property
    def content(self) -> bytes:
        return to_bytes(self.estimator.graph)


def windows_of(scene: Scene) -> list[FilterChoice]:
    """Filters to consider: windows that double, up to the scene's latency."""
    most = (scene.requirements.latency_ms or LONGEST_MS) * scene.sensors.rate_hz / 1000
    return [window_filter(scene, window) for window in WINDOWS if window == 1 or window <= most + 1e-9]


def counts_of(scene: Scene) -> list[int]:
    """Numbers of sensors to consider: the scene's range, or some about the number that it states."""
    fewest, most = scene.sensors.count_range
    if fewest == most:
        fewest, most = max(MIN_SENSORS + 1, fewest - AROUND, len(scene.sensors.fixed_mm)), fewest + 1
    return list(range(fewest, most + 1))


def measured_points(
    scene: Scene, estimators: Sequence[Name], *, draws: int, seed: int, progress: Progress
) -> list[Point]:
    """Make and measure every point; raises SceneError where the scene cannot be built."""
    check_small_angles(scene)
    if reading_noise_mm(scene) == 0:
        message = "sensors: a noise of 0 leaves nothing to trade; state the noise of a reading"
        raise SceneError(message)
    physics = required(scene)
    made: list[_Made] = []
    layouts = [(count, chosen) for count in counts_of(scene) for chosen in windows_of(scene)]
    total = len(layouts) * len(estimators)
    for count, chosen in layouts:
        noise_mm = noise_of(physics, chosen).sample_mm
        layout = np.array(fewest_sensors(physics, noise_mm, count, seed).positions_mm)
        prior = Prior.of(physics, layout, noise_mm)
        drawn = limit.draw(prior, draws, seed + 1)
        best = np.abs(limit.posterior_median_mm(prior, drawn.deflection_mm) - drawn.position_mm)
        for name in estimators:
            progress(f"{name}, {count} sensors, mean of {chosen.window} readings", 0.4 * len(made) / total)
            one = estimator_of(name, prior, with_force=scene.wants_force, seed=seed, progress=lambda _done: None)
            for graph in (one.graph, quantised(one.graph)):
                error, is_quantised = _errors(graph, drawn), graph is not one.graph
                made.append(_Made(replace(one, graph=graph), chosen, prior, is_quantised, error, best))
    progress("timing", 0.8)
    readings = [(one.content, _reading(one.prior)) for one in made]
    times = inference_times(readings, lambda done: progress("timing", 0.8 + 0.2 * done))
    return [_point(scene, one, time) for one, time in zip(made, times, strict=True)]


def _errors(graph: onnx.ModelProto, drawn: limit.Draws) -> Array:
    reading = drawn.deflection_mm.astype(np.float32)
    answers = runner(to_bytes(graph))(reading, np.ones(reading.shape, np.bool_))
    return np.abs(answers["position_mm"].astype(np.float64) - drawn.position_mm)


def _reading(prior: Prior) -> NDArray[np.float32]:
    """A contact a third along the range, with the middle force."""
    low, high = prior.position_mm
    clean: Array = sum(prior.force_n) / 2 * prior.influence_at(np.array([low + (high - low) / 3]))[0]
    return clean.astype(np.float32)


def _point(scene: Scene, made: _Made, times: Times) -> Point:
    length, channels = made.prior.length_mm, made.prior.channels
    poll_ms = (FRAME_BYTES + 2 * channels) * BYTE_BITS / SERIAL_BAUD * 1e3
    error = mean_of(made.error_mm)
    return Point(
        made.estimator.name,
        channels,
        made.filter,
        made.quantised,
        error.scaled(100 / length),
        error.value,
        mean_of(made.best_mm).scaled(100 / length),
        ratio_of(made.error_mm, made.best_mm),
        times,
        poll_ms,
        len(made.content),
        500 / scene.sensors.rate_hz + poll_ms + made.filter.settling_ms + times.p50_us / 1e3,
    )
