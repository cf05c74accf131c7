"""The accuracy and computing time of a surface without each of its physical effects."""

import time
from dataclasses import dataclass

import numpy as np

from beamtouch_models.accuracy.contacts import simulated_enough
from beamtouch_models.accuracy.prior import TABLE, Prior
from beamtouch_models.accuracy.statistics import Measurement, ratio_of
from beamtouch_models.building.sensor_rules import sample_errors, sensor_rules
from beamtouch_models.estimators.posterior.graph import posterior_graph
from beamtouch_models.physics.beam import influence_of
from beamtouch_models.placement import place
from beamtouch_models.pricing.effects import required
from beamtouch_models.pricing.noise import choose_filter, noise_of
from beamtouch_models.scene import Scene
from beamtouch_models.session import runner

REPEATS = 5


@dataclass(frozen=True)
class LeftOut:
    """A surface without one of its physical effects."""

    effect: str
    price: float
    """Price of the effect, in units of the noise of a sample."""
    verdict: str
    error_over_limit: Measurement
    """Ratio for an estimator without the effect, on contacts with all effects."""
    influence_ms: float
    """Time to compute an influence table without the effect."""
    influence_with_ms: float


def physics_trade(scene: Scene, *, draws: int, seed: int) -> list[LeftOut]:
    """Measure the surface without each effect that can be left out, one at a time."""
    chosen = choose_filter(scene)
    noise_mm, physics = noise_of(scene, chosen).sample_mm, required(scene, chosen)
    count = scene.sensors.count_range[0]
    layout = np.array(place(influence_of(physics.scene), sensor_rules(physics.scene), count, seed).positions_mm)
    whole = Prior.real(influence_of(scene), layout, sample_errors(scene, noise_mm))
    contacts = simulated_enough(whole, draws, seed + 1)
    best = contacts.deviation_mm
    if best is None:
        return []
    reading = contacts.drawn.deflection_mm
    whitening = whole.whitening(reading)
    with_ms = _table_ms(whole)
    found = []
    for effect in physics.effects:
        if effect.leave_out is None or effect.price is None:
            continue
        lesser = effect.leave_out(scene)
        without = Prior.real(influence_of(lesser), layout, sample_errors(lesser, noise_mm))
        run = runner(posterior_graph(without, with_force=False).SerializeToString())
        error = contacts.mean_error_mm(run(reading, whitening)["position_mm"])
        ratio = ratio_of(error * contacts.weight, best * contacts.weight)
        found.append(LeftOut(effect.name, effect.price, effect.verdict, ratio, _table_ms(without), with_ms))
    return found


def _table_ms(prior: Prior) -> float:
    """Return the median time to compute an influence table."""
    grid, times = np.linspace(*prior.position_mm, TABLE), []
    for _ in range(REPEATS):
        start = time.perf_counter()
        prior.influence_at(grid)
        times.append(time.perf_counter() - start)
    return float(np.median(times)) * 1e3
