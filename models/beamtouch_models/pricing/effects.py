"""The physical effects of a scene: their prices, and the scene without the negligible ones.

The price of an effect is the largest change in deflection that it causes at any allowed sensor position, over the
scene's loads at the largest force, in units of the noise of a sample. Effects are left out, cheapest first, while the
sum of their prices stays under a tenth. The sum bounds their joint effect.
"""

from dataclasses import replace

import numpy as np

from beamtouch_models.errors import SceneError
from beamtouch_models.physics.beam import sensor_positions_mm
from beamtouch_models.pricing.noise import choose_filter, noise_of, sensor_noise_mm
from beamtouch_models.pricing.prices import EFFECTS, NEGLIGIBLE, Effect, Pricing, changed
from beamtouch_models.scene import Scene

MOST_POSITIONS = 401
"""Largest number of sensor positions at which an effect is priced, evenly chosen from the allowed ones."""


def effects_of(scene: Scene) -> list[Effect]:
    """Price every effect for a scene.

    Raises
    ------
    SceneError
        The noise is 0, so that there is no unit for a price, or the scene cannot be computed.
    """
    noise_mm = noise_of(scene, choose_filter(scene)).sample_mm
    if noise_mm == 0:
        message = "sensors: a noise of 0 puts no price on anything; state the noise of a reading"
        raise SceneError(message)
    allowed = sensor_positions_mm(scene)
    chosen = np.linspace(0, len(allowed) - 1, min(len(allowed), MOST_POSITIONS)).round().astype(np.intp)
    pricing = Pricing(scene, noise_mm, allowed[chosen])
    return _judged([effect(pricing) for effect in EFFECTS])


def required(scene: Scene) -> Scene:
    """Return the scene without its negligible effects; unchanged if there are none, or if its noise is 0.

    If the scene states its noise in percent of the largest deflection, the result states the same noise in mm.
    """
    if sensor_noise_mm(scene) == 0:
        return scene
    removals = [effect.leave_out for effect in effects_of(scene) if effect.verdict == "out" and effect.leave_out]
    if not removals:
        return scene
    smaller = changed(scene, "sensors", noise_mm=sensor_noise_mm(scene), noise_percent_of_max=None)
    for leave_out in removals:
        smaller = leave_out(smaller)
    return smaller


def _judged(effects: list[Effect]) -> list[Effect]:
    """Include the most expensive negligible effects again, until the prices of the rest sum to less than the limit."""
    judged, total = {effect.name: effect for effect in effects}, 0.0
    left_out = [effect for effect in effects if effect.verdict == "out" and effect.leave_out]
    for effect in sorted(left_out, key=lambda effect: effect.price or 0.0):
        total += effect.price or 0.0
        if total >= NEGLIGIBLE:
            reason = f"{effect.reason}; in, as with the other effects left out it would exceed {NEGLIGIBLE:g}"
            judged[effect.name] = replace(effect, verdict="in", reason=reason)
    return list(judged.values())
