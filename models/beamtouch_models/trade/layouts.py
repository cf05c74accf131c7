"""The layouts of a trade, as tasks: each is placed once, and every estimator is built and measured on it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from beamtouch_models.accuracy.contacts import Contacts, simulated_enough
from beamtouch_models.accuracy.prior import Prior
from beamtouch_models.accuracy.statistics import Measurement, mean_of, ratio_of
from beamtouch_models.arrays import Floats, Floats32
from beamtouch_models.building.sensor_rules import sample_errors, sensor_rules
from beamtouch_models.errors import SceneError
from beamtouch_models.estimators.estimator import Name, estimator_of
from beamtouch_models.export import to_bytes
from beamtouch_models.metadata import FilterChoice
from beamtouch_models.physics.beam import influence_of
from beamtouch_models.placement import place
from beamtouch_models.pricing.effects import required
from beamtouch_models.pricing.noise import check_errors, noise_of, window_filter
from beamtouch_models.progress import silent
from beamtouch_models.scene import Scene
from beamtouch_models.scene.sensors import MIN_SENSORS
from beamtouch_models.session import runner
from beamtouch_models.trade.point import Failure
from beamtouch_models.trade.quantised import quantised

WINDOWS = (1, 2, 4, 8, 16)
MAX_LATENCY_MS = 100.0
"""Longest filter if the scene states no latency."""
AROUND = 2
"""If the scene states a number of sensors, fewer ones down to AROUND less are measured, and one more."""


@dataclass(frozen=True)
class Layout:
    """A number of sensors behind a filter, as a task that can be sent."""

    scene: Scene
    sensors: int
    filter: FilterChoice
    estimators: tuple[Name, ...]
    draws: int
    seed: int


@dataclass(frozen=True)
class Untimed:
    """A point whose inference is not timed yet."""

    estimator: Name
    filter: FilterChoice
    quantised: bool
    length_mm: float
    error_mm: Measurement
    limit_mm: Measurement
    ratio: Measurement
    content: bytes
    """The graph."""
    deflection_mm: Floats32
    """(1, channels), a contact to time the graph with."""
    whitening_per_mm: Floats32
    """(1, channels, channels)"""


def windows_of(scene: Scene) -> list[FilterChoice]:
    """Return the filters to measure: windows that double, up to the scene's latency."""
    most = (scene.requirements.latency_ms or MAX_LATENCY_MS) * scene.sensors.rate_hz / 1000
    return [window_filter(scene, window) for window in WINDOWS if window == 1 or window <= most + 1e-9]


def counts_of(scene: Scene) -> list[int]:
    """Return the numbers of sensors to measure: the scene's range, or numbers around the one that it states."""
    stated, most = scene.sensors.count_range
    fewest = scene.sensors.fewest
    if stated == most:
        fewest, most = max(MIN_SENSORS + 1, stated - AROUND, len(scene.sensors.fixed_mm)), stated + 1
    return list(range(fewest, most + 1))


def layouts_of(scene: Scene, estimators: Sequence[Name], *, draws: int, seed: int) -> list[Layout]:
    """Return the layouts to measure, the fewest sensors first."""
    return [
        Layout(scene, count, chosen, tuple(estimators), draws, seed)
        for count in counts_of(scene)
        for chosen in windows_of(scene)
    ]


def measured(layout: Layout) -> list[Untimed | Failure]:
    """Build and measure every estimator of a layout; what cannot be built is a failure."""
    scene, chosen = layout.scene, layout.filter
    try:
        check_errors(scene, chosen)
        prior, contacts = _contacts(layout)
    except SceneError as error:
        return [Failure(None, layout.sensors, chosen, str(error))]
    found: list[Untimed | Failure] = []
    for name in layout.estimators:
        try:
            found += _made(layout, name, prior, contacts)
        except SceneError as error:
            found.append(Failure(name, layout.sensors, chosen, str(error)))
    return found


def _contacts(layout: Layout) -> tuple[Prior, Contacts]:
    physics = required(layout.scene, layout.filter)
    influence, errors = influence_of(physics.scene), sample_errors(physics.scene, physics.noise.sample_mm)
    placed = place(influence, sensor_rules(physics.scene), layout.sensors, layout.seed)
    prior = Prior.real(influence, np.array(placed.positions_mm), errors)
    return prior, simulated_enough(prior, layout.draws, layout.seed + 1)


def _made(layout: Layout, name: Name, prior: Prior, contacts: Contacts) -> list[Untimed]:
    """Return an estimator as it is and with 8-bit weights; SceneError if an answer is not finite."""
    scene, chosen = layout.scene, layout.filter
    best, weight = contacts.deviation_mm, contacts.weight
    min_noise_mm = chosen.min_noise_mm(noise_of(scene, chosen))
    one = estimator_of(
        name, prior, min_noise_mm=min_noise_mm, with_force=scene.wants_force, seed=layout.seed, progress=silent
    )
    reading, sample = contacts.drawn.deflection_mm, _sample(prior)
    found = []
    for graph in (one.graph, quantised(one.graph)):
        content = to_bytes(graph)
        answers = runner(content)(reading, prior.whitening(reading))
        error = contacts.mean_error_mm(answers["position_mm"])
        if best is None or not np.isfinite(error).all():
            message = "some of its answers are not finite"
            raise SceneError(message)
        figures = mean_of(error, weight), mean_of(best, weight), ratio_of(error * weight, best * weight)
        found.append(Untimed(name, chosen, graph is not one.graph, prior.length_mm, *figures, content, *sample))
    return found


def _sample(prior: Prior) -> tuple[Floats32, Floats32]:
    """Return the deflection of a contact at a third of the range, with the middle force, and its whitening."""
    low, high = prior.position_mm
    clean: Floats = sum(prior.force_n) / 2 * prior.influence_at(np.array([low + (high - low) / 3]))
    return clean.astype(np.float32), prior.whitening(clean).astype(np.float32)
