"""The accuracy and computing time of a surface without each of its physical effects."""

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from beamtouch_models.accuracy.contacts import Contacts, simulated_enough
from beamtouch_models.accuracy.prior import TABLE, Prior
from beamtouch_models.accuracy.statistics import Measurement, ratio_of
from beamtouch_models.building.sensor_rules import sample_errors, sensor_rules
from beamtouch_models.estimators.posterior.graph import posterior_graph
from beamtouch_models.physics.beam import influence_of
from beamtouch_models.placement import place
from beamtouch_models.pricing.effects import required
from beamtouch_models.pricing.noise import choose_filter, noise_of, sensor_noise_mm
from beamtouch_models.pricing.removal import changed
from beamtouch_models.scene import Scene
from beamtouch_models.session import runner

REPEATS = 5


@dataclass(frozen=True)
class EffectLeftOut:
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


@dataclass(frozen=True)
class Question:
    """The contacts on which effects are left out, as a task that can be sent."""

    scene: Scene
    draws: int
    seed: int


def errors_left_out(question: Question) -> list[Measurement]:
    """Return the ratio for each effect that can be left out, one at a time, in the order of `physics_trade`."""
    draws, seed = question.draws, question.seed
    touched: dict[int, Contacts] = {}
    found = []
    for pair in _pairs(question.scene, seed):
        if id(pair.base) not in touched:
            touched[id(pair.base)] = simulated_enough(pair.base, draws, seed + 1)
        found.append(_error_over_limit(touched[id(pair.base)], pair.without))
    return found


def physics_trade(scene: Scene, ratios: Sequence[Measurement], seed: int) -> list[EffectLeftOut]:
    """Return the surface without each effect that can be left out, with the times to compute its influence tables.

    `ratios` are those of `errors_left_out`. The machine should do nothing else. The surface has the fewest sensors
    that the scene allows. Steps are left out of a beam without shear, because shear depends on the sections.
    """
    return [
        EffectLeftOut(pair.effect, pair.price, pair.verdict, ratio, _table_ms(pair.without), _table_ms(pair.base))
        for pair, ratio in zip(_pairs(scene, seed), ratios, strict=True)
    ]


@dataclass(frozen=True)
class _Pair:
    """A surface with and without an effect."""

    effect: str
    price: float
    verdict: str
    base: Prior
    without: Prior


def _pairs(scene: Scene, seed: int) -> list[_Pair]:
    chosen = choose_filter(scene)
    physics = required(scene, chosen)
    influence, rules = influence_of(physics.scene), sensor_rules(physics.scene)
    layout = np.array(place(influence, rules, scene.sensors.fewest, seed).positions_mm)
    reading_mm = sensor_noise_mm(scene)

    def prior_of(one: Scene) -> Prior:
        # The sensors are the same in each: their noise does not follow the deflection that an effect changes.
        same = changed(one, "sensors", noise_mm=reading_mm, noise_percent_of_max=None)
        return Prior.real(influence_of(same), layout, sample_errors(same, noise_of(same, chosen).sample_mm))

    whole = prior_of(scene)
    found = []
    for effect in physics.effects:
        if effect.leave_out is None or effect.price is None:
            continue
        without = prior_of(effect.lacking or effect.leave_out(scene))
        if without.noise_mm == 0:  # the steps of the ADC are all of the noise, and without noise there is no estimator
            continue
        base = whole if effect.having is None or effect.having == scene else prior_of(effect.having)
        found.append(_Pair(effect.name, effect.price, effect.verdict, base, without))
    return found


def _error_over_limit(contacts: Contacts, without: Prior) -> Measurement:
    """Return the error of the estimator of a prior that lacks an effect of the contacts, over their accuracy limit."""
    best, reading = contacts.deviation_mm, contacts.drawn.deflection_mm
    if best is None:
        message = "without noise there is no accuracy limit"
        raise ValueError(message)
    run = runner(posterior_graph(without, with_force=False).SerializeToString())
    error = contacts.mean_error_mm(run(reading, without.whitening(reading))["position_mm"])
    return ratio_of(error * contacts.weight, best * contacts.weight)


def _table_ms(prior: Prior) -> float:
    """Return the median time to compute an influence table."""
    grid, times = np.linspace(*prior.position_mm, TABLE), []
    for _ in range(REPEATS):
        start = time.perf_counter()
        prior.influence_at(grid)
        times.append(time.perf_counter() - start)
    return float(np.median(times)) * 1e3
