"""Prices of what beams and plates share: the width of a contact, and ringing."""

from functools import partial

from beamtouch_common.digits import digits
from beamtouch_models.design.physics import motion
from beamtouch_models.design.pricing.effect import NEGLIGIBLE, Effect, Pricing, effect_stated
from beamtouch_models.design.scene import change_scene

without_width = partial(change_scene, contact={"width_mm": 0.0})
"""The scene with point contacts."""


def contact_width(pricing: Pricing) -> Effect:
    """Price the width of a contact."""
    width = pricing.scene.contact.width_mm
    if width == 0:
        return Effect("contact width", 0.0, "out", "the scene states a point contact")
    return effect_stated(pricing, "contact width", f"{width:g} mm", without_width)


def dynamics(pricing: Pricing) -> Effect:
    """Price the ringing that is left once the filter has settled."""
    scene = pricing.scene
    frequency = motion.first_frequency_hz(scene.solid)
    if frequency is None:
        return Effect(
            "dynamics",
            None,
            "not stated",
            "state density_kg_m3 or material" + (", with width_mm and thickness_mm" if scene.has_beam else ""),
        )
    damping_ratio = motion.damping_of(scene.solid)
    still = motion.ringing_after_filter(frequency, damping_ratio, pricing.filter, scene.sensors.rate_hz)
    price = pricing.price_of_all * still
    assumed = " (assumed)" if scene.solid.damping_ratio is None else ""
    told = f"rings at {digits(frequency, 3)} Hz, damped by {digits(100 * damping_ratio, 2)} %{assumed}"
    if price < NEGLIGIBLE:
        return Effect("dynamics", price, "out", f"{told}; it has decayed once the filter has settled")
    return Effect("dynamics", price, "not modelled", f"{told}; intervals are wide until it is still")
