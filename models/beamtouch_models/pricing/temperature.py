"""The price of temperature: the expansion of a beam that is held lengthwise, and the drift of its sensors."""

import numpy as np

from beamtouch_common.digits import digits
from beamtouch_models.errors import SceneError
from beamtouch_models.physics.axial import Held, held, held_stretch_mm, influence_change
from beamtouch_models.physics.beam import load_positions_mm
from beamtouch_models.pricing.effect import NEGLIGIBLE, Effect, Pricing
from beamtouch_models.pricing.noise import temperature_drift_mm, zero_drift_mm
from beamtouch_models.scene import Scene

NEAR = 0.5
"""Share of the critical force from which buckling is near: an imperfect beam bows there (Southwell)."""


def expansion(pricing: Pricing) -> Effect:
    """Price the axial force in a held beam, at both ends of the temperature range; SceneError if the beam buckles."""
    name, scene = "expansion", pricing.scene
    stretch, range_k = held_stretch_mm(scene.beam), scene.environment.temperature_range_k
    if stretch is None:
        return Effect(name, 0.0, "out", "the beam can lengthen: at most one support holds it lengthwise")
    found = held(scene.beam)
    if found is None:
        return Effect(name, None, "not stated", "give beam.material or expansion_um_per_m_k, and thickness_mm")
    buckles = f"it buckles {digits(found.buckles_k, 3)} K above its mounting"
    where = f"held at {stretch[0]:g} and {stretch[1]:g} mm, {buckles}"
    if range_k is None:
        return Effect(name, None, "not stated", f"give environment.temperature_range_k; {where}")
    change = [_change(pricing, found, one_k) for one_k in range_k]
    still = pricing.deflection_mm(scene)
    price = max(pricing.in_noise(one) for one in change)
    share = [100 * float(one.flat[peak] / still.flat[peak]) for one in change for peak in [np.abs(still).argmax()]]
    forces = "..".join(digits(found.force_n_per_k * one_k, 3) for one_k in range_k)
    reason = f"{where}; {forces} N of compression change the largest deflection by {share[0]:+.2g}..{share[1]:+.2g} %"
    if price < NEGLIGIBLE:
        return Effect(name, price, "out", reason)
    if range_k[1] > NEAR * found.buckles_k:
        reason += "; buckling is near, so let one support slide"
    return Effect(name, price, "not modelled", reason, scene)


def _change(pricing: Pricing, found: Held, warming_k: float) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """Return the change of the deflection at the largest force, (loads, sensors) in mm."""
    scene, loads = pricing.scene, load_positions_mm(pricing.scene)
    half = scene.contact.width_mm / 2
    low, high = np.maximum(loads - half, 0.0), np.minimum(loads + half, scene.beam.length_mm)
    change = influence_change(scene.beam, found.force_n_per_k * warming_k, pricing.sensor_mm, low, high)
    if change is None:
        raise SceneError(_buckles(scene, found))
    return scene.contact.force_range_n[1] * change


def _buckles(scene: Scene, found: Held) -> str:
    warmest = scene.environment.temperature_range_k or (0.0, 0.0)
    return (
        f"environment.temperature_range_k: {warmest[1]:g} K above its mounting the beam buckles, as it is held at "
        f"{found.start_mm:g} and {found.end_mm:g} mm and bears {digits(found.buckles_k, 3)} K; let one support slide "
        "(slides = true), or mount it warmer"
    )


def sensor_drift(pricing: Pricing) -> Effect:
    """Price the drift of the sensors with the temperature beside the other drift of their zeros."""
    name, sensors, range_k = "sensor drift", pricing.scene.sensors, pricing.scene.environment.temperature_range_k
    if range_k is None:
        return Effect(name, None, "not stated", "give environment.temperature_range_k and sensors.drift_um_per_k")
    if sensors.drift_um_per_k is None:
        return Effect(name, None, "not stated", "give sensors.drift_um_per_k")
    drift_mm, zero_mm = temperature_drift_mm(pricing.scene), zero_drift_mm(pricing.scene)
    span_k = range_k[1] - range_k[0]
    beside = f"{digits(drift_mm / zero_mm, 2)} times" if zero_mm else "beside no"
    reason = (
        f"up to {digits(sensors.drift_um_per_k * span_k, 3)} um after a tare at the other end of {span_k:g} K, "
        f"{digits(1000 * drift_mm, 3)} um as a standard deviation, {beside} zero drift; it never averages away"
    )
    return Effect(name, pricing.in_noise(np.array([drift_mm])), "floor", reason)
