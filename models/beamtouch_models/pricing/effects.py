"""The physics of a scene: each effect priced once for a filter, and the scene without the negligible effects.

The price of an effect is the largest change in deflection that it causes at any allowed sensor position, over the
scene's loads at the largest force, in units of the noise of a sample. Effects are left out, cheapest first, while the
sum of their prices stays under a tenth. The sum bounds their joint effect.
"""

from dataclasses import dataclass, replace

import numpy as np

from beamtouch_models.errors import SceneError
from beamtouch_models.metadata import FilterChoice, Noise
from beamtouch_models.physics.beam import sensor_positions_mm
from beamtouch_models.pricing.effect import NEGLIGIBLE, Effect, Pricing
from beamtouch_models.pricing.noise import noise_of, reading_noise_mm, sensor_noise_mm
from beamtouch_models.pricing.prices import EFFECTS
from beamtouch_models.pricing.removal import changed
from beamtouch_models.scene import Scene

MAX_POSITIONS = 401
"""Largest number of sensor positions at which an effect is priced, evenly chosen from the allowed ones."""


@dataclass(frozen=True)
class Physics:
    """The physics of a model: the effects that the scene requires behind a filter, and all prices."""

    scene: Scene
    """The scene without its negligible effects."""
    filter: FilterChoice
    """The filter whose noise the effects were priced in."""
    effects: tuple[Effect, ...]
    """All effects with their prices; empty if a sample has no noise, which leaves nothing to compare them to."""

    @property
    def noise(self) -> Noise:
        """Noise of a reading and of a sample, the same as of the stated scene."""
        return noise_of(self.scene, self.filter)


def effects_of(scene: Scene, chosen: FilterChoice) -> tuple[Effect, ...]:
    """Price every effect of a scene, in the noise of a sample behind a filter.

    Raises
    ------
    SceneError
        The noise is 0, so that a price has no unit, or the scene cannot be computed.
    """
    noise_mm = noise_of(scene, chosen).sample_mm
    if noise_mm == 0:
        message = "sensors: with a noise of 0, effects have no price; state the noise of a reading"
        raise SceneError(message)
    allowed = sensor_positions_mm(scene)
    at = np.linspace(0, len(allowed) - 1, min(len(allowed), MAX_POSITIONS)).round().astype(np.intp)
    pricing = Pricing(scene, chosen, noise_mm, allowed[at])
    return _judged([effect(pricing) for effect in EFFECTS])


def required(scene: Scene, chosen: FilterChoice) -> Physics:
    """Return the physics that a scene requires behind a filter.

    If a sample has no noise, neither of the sensors nor from the steps of an ADC, all of the scene is required. If
    effects are left out, the result states the noise of the scene in mm; it contains the steps of an ADC that is left
    out. Raises SceneError if the scene cannot be computed.
    """
    if noise_of(scene, chosen).sample_mm == 0:
        return Physics(scene, chosen, ())
    effects = effects_of(scene, chosen)
    removals = [effect.leave_out for effect in effects if effect.verdict == "out" and effect.leave_out]
    smaller = scene
    for leave_out in removals:
        smaller = leave_out(smaller)
    if removals:
        has_steps = smaller.sensors.adc_bits is not None
        noise_mm = sensor_noise_mm(scene) if has_steps else reading_noise_mm(scene)
        smaller = changed(smaller, "sensors", noise_mm=noise_mm, noise_percent_of_max=None)
    return Physics(smaller, chosen, effects)


def _judged(effects: list[Effect]) -> tuple[Effect, ...]:
    """Include the most expensive negligible effects again, until the prices of the rest sum to less than the limit."""
    judged, total = {effect.name: effect for effect in effects}, 0.0
    left_out = [effect for effect in effects if effect.verdict == "out" and effect.leave_out]
    for effect in sorted(left_out, key=lambda effect: effect.price or 0.0):
        total += effect.price or 0.0
        if total >= NEGLIGIBLE:
            reason = f"{effect.reason}; included, as the effects left out would together exceed {NEGLIGIBLE:g}"
            judged[effect.name] = replace(effect, verdict="in", reason=reason)
    return tuple(judged.values())
