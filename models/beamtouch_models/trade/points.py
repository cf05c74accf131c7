"""Builds and measures the points of the trade."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial

import numpy as np

from beamtouch_models.accuracy.contacts import Contacts, simulated_enough
from beamtouch_models.accuracy.prior import Prior
from beamtouch_models.accuracy.statistics import Measurement, mean_of, ratio_of
from beamtouch_models.arrays import Floats, Floats32
from beamtouch_models.building.checks import check_scene
from beamtouch_models.building.sensor_rules import sample_errors, sensor_rules
from beamtouch_models.errors import SceneError
from beamtouch_models.estimators.estimator import Estimator, Name, estimator_of
from beamtouch_models.export import to_bytes
from beamtouch_models.metadata import FilterChoice
from beamtouch_models.physics.beam import influence_of
from beamtouch_models.placement import place
from beamtouch_models.pricing.effects import Physics, required
from beamtouch_models.pricing.noise import check_errors, choose_filter, noise_of, window_filter
from beamtouch_models.progress import Fraction, Progress, silent
from beamtouch_models.scene import MIN_SENSORS, Scene
from beamtouch_models.session import runner
from beamtouch_models.trade.point import Failure, Point, Trade
from beamtouch_models.trade.quantised import quantised
from beamtouch_models.trade.timing import ROUNDS, Times, inference_times

WINDOWS = (1, 2, 4, 8, 16)
LONGEST_MS = 100.0
"""Longest filter if the scene states no latency."""
AROUND = 2
"""If the scene states a number of sensors, fewer ones down to AROUND less are measured, and one more."""
FIRST_ROUNDS = 5
"""Rounds of timing for intermediate results; at the end all points are timed again, in turns."""
SERIAL_BAUD, FRAME_BYTES, BYTE_BITS = 1_000_000, 13, 10
"""Transfer of a reading by PROTOCOL.md: FRAME_BYTES and two bytes per channel, of ten bits each."""


@dataclass(frozen=True)
class _Made:
    estimator: Estimator
    filter: FilterChoice
    prior: Prior
    quantised: bool
    error_mm: Measurement
    best_mm: Measurement
    ratio: Measurement

    @property
    def content(self) -> bytes:
        return to_bytes(self.estimator.graph)


def windows_of(scene: Scene) -> list[FilterChoice]:
    """Return the filters to measure: windows that double, up to the scene's latency."""
    most = (scene.requirements.latency_ms or LONGEST_MS) * scene.sensors.rate_hz / 1000
    return [window_filter(scene, window) for window in WINDOWS if window == 1 or window <= most + 1e-9]


def counts_of(scene: Scene) -> list[int]:
    """Return the numbers of sensors to measure: the scene's range, or numbers around the one that it states."""
    stated, most = scene.sensors.count_range
    fewest = scene.sensors.fewest
    if stated == most:
        fewest, most = max(MIN_SENSORS + 1, stated - AROUND, len(scene.sensors.fixed_mm)), stated + 1
    return list(range(fewest, most + 1))


def measured_points(
    scene: Scene,
    estimators: Sequence[Name],
    *,
    draws: int,
    seed: int,
    progress: Progress,
    keep: Callable[[Trade], None] = lambda _trade: None,
) -> Trade:
    """Build and measure every point.

    Parameters
    ----------
    scene, estimators : the scene, and the estimators to measure
    draws, seed : contacts per point, and the seed of all random numbers
    progress : called with the current point
    keep : called with the points so far, after each estimator of a layout

    Raises
    ------
    SceneError
        A build refuses the scene, or no point can be built. If only some points fail, they are listed as failures.
    """
    check_scene(scene, choose_filter(scene))
    total = len(counts_of(scene)) * len(windows_of(scene)) * len(estimators)
    made: list[_Made] = []
    points: list[Point] = []
    failures: list[Failure] = []
    for number, count, chosen, simulated in _layouts(scene, draws, seed):
        if isinstance(simulated, SceneError):
            failures.append(Failure(None, count, chosen, str(simulated)))
            continue
        for index, name in enumerate(estimators):
            doing = f"{name}, {count} sensors, mean of {chosen.window} readings"
            progress(doing, 0.8 * (number * len(estimators) + index) / total)
            try:
                found = _made(scene, name, chosen, *simulated, seed)
            except SceneError as error:
                failures.append(Failure(name, count, chosen, str(error)))
                continue
            made += found
            points += _timed(scene, found, FIRST_ROUNDS, silent)
            keep(Trade(tuple(points), tuple(failures), 2 * total))
    if not made:
        raise SceneError(failures[0].reason)
    points = _timed(scene, made, ROUNDS, lambda done: progress("timing", 0.8 + 0.2 * done))
    return Trade(tuple(points), tuple(failures), 2 * total)


def _layouts(
    scene: Scene, draws: int, seed: int
) -> Iterator[tuple[int, int, FilterChoice, tuple[Prior, Contacts] | SceneError]]:
    """Yield for every layout its number, sensors, filter, and prior with contacts, or the error if it has none."""
    physics_of = cache(partial(required, scene))
    layouts = [(count, chosen) for count in counts_of(scene) for chosen in windows_of(scene)]
    for number, (count, chosen) in enumerate(layouts):
        try:
            check_errors(scene, chosen)
            yield number, count, chosen, _contacts(physics_of(chosen), count, draws, seed)
        except SceneError as error:
            yield number, count, chosen, error


def _contacts(physics: Physics, count: int, draws: int, seed: int) -> tuple[Prior, Contacts]:
    influence, errors = influence_of(physics.scene), sample_errors(physics.scene, physics.noise.sample_mm)
    layout = np.array(place(influence, sensor_rules(physics.scene), count, seed).positions_mm)
    prior = Prior.real(influence, layout, errors)
    return prior, simulated_enough(prior, draws, seed + 1)


def _made(scene: Scene, name: Name, chosen: FilterChoice, prior: Prior, contacts: Contacts, seed: int) -> list[_Made]:
    """Return an estimator as it is and with 8-bit weights; SceneError if an answer is not finite."""
    best, weight = contacts.deviation_mm, contacts.weight
    least_noise_mm = chosen.least_noise_mm(noise_of(scene, chosen))
    one = estimator_of(
        name, prior, least_noise_mm=least_noise_mm, with_force=scene.wants_force, seed=seed, progress=silent
    )
    reading = contacts.drawn.deflection_mm
    found = []
    for graph in (one.graph, quantised(one.graph)):
        answers = runner(to_bytes(graph))(reading, prior.whitening(reading))
        error = contacts.mean_error_mm(answers["position_mm"])
        if best is None or not np.isfinite(error).all():
            message = "some of its answers are not finite"
            raise SceneError(message)
        figures = mean_of(error, weight), mean_of(best, weight), ratio_of(error * weight, best * weight)
        found.append(_Made(replace(one, graph=graph), chosen, prior, graph is not one.graph, *figures))
    return found


def _timed(scene: Scene, made: Sequence[_Made], rounds: int, progress: Fraction) -> list[Point]:
    readings = [(one.content, *_sample(one.prior)) for one in made]
    times = inference_times(readings, progress, rounds)
    return [_point(scene, one, time) for one, time in zip(made, times, strict=True)]


def _sample(prior: Prior) -> tuple[Floats32, Floats32]:
    """Return the deflection of a contact at a third of the range, with the middle force, and its whitening."""
    low, high = prior.position_mm
    clean: Floats = sum(prior.force_n) / 2 * prior.influence_at(np.array([low + (high - low) / 3]))
    return clean.astype(np.float32), prior.whitening(clean).astype(np.float32)


def _point(scene: Scene, made: _Made, times: Times) -> Point:
    length, channels = made.prior.length_mm, made.prior.channels
    poll_ms = (FRAME_BYTES + 2 * channels) * BYTE_BITS / SERIAL_BAUD * 1e3
    return Point(
        made.estimator.name,
        channels,
        made.filter,
        made.quantised,
        made.error_mm.scaled(100 / length),
        made.error_mm.value,
        made.best_mm.scaled(100 / length),
        made.ratio,
        times,
        poll_ms,
        len(made.content),
        500 / scene.sensors.rate_hz + poll_ms + made.filter.settling_ms + times.p50_us / 1e3,
    )
