"""What a scene requires: its effects, priced, and the scene without those that are worth too little.

The price of an effect is the largest change in deflection it causes at any allowed sensor position, over the scene's
loads at the largest force, in units of the noise of a sample. Effects are left out, cheapest first, as long as the
prices of all that is left out stay under a tenth together: the sum bounds what they can do at once.
"""

from dataclasses import replace

import numpy as np

from beamtouch_models.errors import SceneError
from beamtouch_models.layout import candidates
from beamtouch_models.noise import choose_filter, noise_of, sensor_noise_mm
from beamtouch_models.pricing import EFFECTS, NEGLIGIBLE, Effect, Pricing, changed
from beamtouch_models.scene import Scene

MOST_POSITIONS = 401
"""Sensor positions that an effect is priced at, evenly chosen from those allowed."""


def effects_of(scene: Scene) -> list[Effect]:
    """Price every effect for a scene.

    Raises
    ------
    SceneError
        The noise is 0, in which no price can be stated, or the scene cannot be computed with.
    """
    noise_mm = noise_of(scene, choose_filter(scene)).sample_mm
    if noise_mm == 0:
        message = "sensors: a noise of 0 puts no price on anything; state the noise of a reading"
        raise SceneError(message)
    allowed = candidates(scene).position_mm
    chosen = np.linspace(0, len(allowed) - 1, min(len(allowed), MOST_POSITIONS)).round().astype(np.intp)
    pricing = Pricing(scene, noise_mm, allowed[chosen])
    return _judged([effect(pricing) for effect in EFFECTS])


def required(scene: Scene) -> Scene:
    """Return the scene without the effects that are out; the scene itself where nothing is, or where its noise is 0.

    Noise given in percent of the largest deflection is then stated in mm, so that it stays what it was.
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
    """Take back, dearest first, what would make the sum of all that is left out exceed the limit."""
    judged, total = {effect.name: effect for effect in effects}, 0.0
    left_out = [effect for effect in effects if effect.verdict == "out" and effect.leave_out]
    for effect in sorted(left_out, key=lambda effect: effect.price or 0.0):
        total += effect.price or 0.0
        if total >= NEGLIGIBLE:
            reason = f"{effect.reason}; in, as with the other effects left out it would exceed {NEGLIGIBLE:g}"
            judged[effect.name] = replace(effect, verdict="in", reason=reason)
    return list(judged.values())
