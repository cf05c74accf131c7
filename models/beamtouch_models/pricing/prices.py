"""The price of each single physical effect in a scene."""

import math
from collections.abc import Callable

import numpy as np
from pydantic import ValidationError

from beamtouch_common.digits import digits
from beamtouch_models.physics import dynamics
from beamtouch_models.physics.beam import influence_of, load_positions_mm
from beamtouch_models.pricing.effect import NEGLIGIBLE, Effect, Pricing, Verdict, verdict_of
from beamtouch_models.pricing.noise import adc_step_mm, floor_of, rounding_mm, zero_drift_mm
from beamtouch_models.pricing.removal import (
    changed,
    without_adc,
    without_foundation,
    without_shear,
    without_steps,
    without_tolerance,
    without_width,
)
from beamtouch_models.pricing.temperature import expansion, sensor_drift

POISSON_RATIO = 0.3
"""Value of most metals; it gives the shear modulus if the scene does not state one."""


def _shear(pricing: Pricing) -> Effect:
    scene, beam = pricing.scene, pricing.scene.beam
    if beam.shear_modulus_gpa is not None:
        lacking = without_shear(scene)
        price = pricing.price(scene, lacking)
        reason = f"shear modulus {beam.shear_modulus_gpa:g} GPa"
        return Effect("shear", price, verdict_of(price), reason, scene, lacking, without_shear)
    if beam.modulus_gpa is None or any(section.area_mm2 is None for section in beam.sections):
        return Effect("shear", None, "not stated", "give shear_modulus_gpa with width_mm and thickness_mm")
    modulus = beam.modulus_gpa / (2 * (1 + POISSON_RATIO))
    having = changed(scene, "beam", shear_modulus_gpa=modulus)
    price = pricing.price(having, scene)
    if price < NEGLIGIBLE:
        reason = f"estimated with a Poisson ratio of {POISSON_RATIO:g}"
        return Effect("shear", price, "out", reason, having, scene)
    reason = f"state beam.shear_modulus_gpa to include it, {digits(modulus, 3)} at a Poisson ratio of {POISSON_RATIO:g}"
    return Effect("shear", price, "not modelled", reason, having, scene)


def _contact_width(pricing: Pricing) -> Effect:
    scene, width = pricing.scene, pricing.scene.contact.width_mm
    if width == 0:
        return Effect("contact width", 0.0, "out", "the scene states a point contact")
    lacking = without_width(scene)
    price = pricing.price(scene, lacking)
    return Effect("contact width", price, verdict_of(price), f"{width:g} mm", scene, lacking, without_width)


def _self_weight(pricing: Pricing) -> Effect:
    # Deflections are linear in the load: after a tare, a contact adds the same deflection with or without the weight.
    sag = dynamics.sag_mm(pricing.scene.beam)
    told = "" if sag is None else f"; the beam sags by {digits(sag, 3)} mm, which the stand-off must allow for"
    return Effect("self-weight", 0.0, "out", f"constant, removed by the tare{told}")


def _overhang(pricing: Pricing) -> Effect:
    scene, supports = pricing.scene, pricing.scene.beam.support_list
    places = [support.at_mm for support in supports]
    if len(places) < 2 or (places[0] == 0 and places[-1] == scene.beam.length_mm):
        return Effect("overhang", 0.0, "out", "no overhang")
    loads, sensors = load_positions_mm(scene), pricing.sensor_mm
    off_loads, off_sensors = ((at < places[0]) | (at > places[-1]) for at in (loads, sensors))
    price = pricing.in_noise(pricing.deflection_mm(scene)[off_loads[:, None] | off_sensors])
    if price == 0:
        return Effect("overhang", 0.0, "out", "no load or sensor on an overhang")
    return Effect("overhang", price, "in", f"beyond the supports at {places[0]:g} and {places[-1]:g} mm")


def _steps(pricing: Pricing) -> Effect:
    scene = pricing.scene
    if len({section.rigidity_n_mm2 for section in scene.beam.sections}) == 1:
        return Effect("steps", 0.0, "out", "a single section")
    # The prismatic beam has no section for shear to depend on, so compare the two without shear.
    having, lacking = without_shear(scene), without_steps(scene)
    price = pricing.price(having, lacking)
    mean = digits(lacking.beam.rigidity_n_mm2, 4)
    reason = f"compared to a prismatic beam of the same mean compliance, {mean} N mm^2"
    if price < NEGLIGIBLE and scene.beam.shear_modulus_gpa is not None:
        return Effect(
            "steps", price, "in", f"{reason}; included, because shear depends on the sections", having, lacking
        )
    return Effect("steps", price, verdict_of(price), reason, having, lacking, without_steps)


def _foundation(pricing: Pricing) -> Effect:
    scene = pricing.scene
    if scene.beam.foundation_n_mm2 is None:
        return Effect("foundation", 0.0, "out", "no foundation")
    reason = f"{digits(scene.beam.foundation_n_mm2, 6)} N/mm per mm"
    try:
        lacking = without_foundation(scene)
    except ValidationError:
        whole = pricing.in_noise(pricing.deflection_mm(scene))
        return Effect("foundation", whole, "in", f"{reason}; nothing else supports the beam", scene)
    price = pricing.price(scene, lacking)
    return Effect("foundation", price, verdict_of(price), reason, scene, lacking, without_foundation)


def _dynamics(pricing: Pricing) -> Effect:
    scene = pricing.scene
    frequency = dynamics.first_frequency_hz(scene.beam)
    if frequency is None:
        return Effect("dynamics", None, "not stated", "give density_kg_m3 or material, with width_mm and thickness_mm")
    damping_ratio = dynamics.damping_of(scene.beam)
    still = dynamics.ringing_after_filter(frequency, damping_ratio, pricing.filter, scene.sensors.rate_hz)
    price = pricing.in_noise(pricing.deflection_mm(scene)) * still
    assumed = " (assumed)" if scene.beam.damping_ratio is None else ""
    told = f"rings at {digits(frequency, 3)} Hz, damped by {digits(100 * damping_ratio, 2)} %{assumed}"
    if price < NEGLIGIBLE:
        return Effect("dynamics", price, "out", f"{told}; decayed once the filter has settled")
    return Effect("dynamics", price, "not modelled", f"{told}; intervals are as long as the readings scatter meanwhile")


def _gain_error(pricing: Pricing) -> Effect:
    gain, _ = floor_of(pricing.scene)
    stated = "" if pricing.scene.sensors.gain_error_percent is not None else ", as the scene states none"
    left = f"calibration leaves an error of {digits(100 * gain, 3)} % of the deflection"
    reason = f"{left}{stated}; it never averages away"
    return Effect("gain error", gain * pricing.in_noise(pricing.deflection_mm(pricing.scene)), "floor", reason)


def _zero_drift(pricing: Pricing) -> Effect:
    zero_mm = zero_drift_mm(pricing.scene)
    stated = "" if pricing.scene.sensors.zero_drift_mm is not None else ", as the scene states none"
    reason = f"{digits(1000 * zero_mm, 3)} um since the last tare{stated}; it never averages away"
    return Effect("zero drift", pricing.in_noise(np.array([zero_mm])), "floor", reason)


def _mounting_tolerance(pricing: Pricing) -> Effect:
    scene, tolerance_mm = pricing.scene, pricing.scene.sensors.mounting_tolerance_mm
    if tolerance_mm == 0:
        return Effect("mounting tolerance", 0.0, "out", "the scene states none")
    moved = influence_of(scene).deviation(pricing.sensor_mm, load_positions_mm(scene), tolerance_mm)
    price = pricing.in_noise(scene.contact.force_range_n[1] * moved)
    reason = f"+- {tolerance_mm:g} mm along the beam; `calibrate` finds the true positions"
    verdict: Verdict = "out" if price < NEGLIGIBLE else "floor"
    return Effect("mounting tolerance", price, verdict, reason, leave_out=without_tolerance)


def _sensor_curve(pricing: Pricing) -> Effect:
    low, high = pricing.scene.sensors.range_mm
    return Effect(
        "sensor curve", None, "not stated", f"assumed linear over {low:g}..{high:g} mm; calibrate corrects it"
    )


def _adc_steps(pricing: Pricing) -> Effect:
    scene = pricing.scene
    if scene.sensors.adc_bits is None:
        return Effect("ADC steps", None, "not stated", "give sensors.adc_bits")
    # Standard deviations, like the noise that they are compared to. The rounding errors of readings are independent
    # only as far as noise moves the readings over the steps.
    step, stays_mm = adc_step_mm(scene), rounding_mm(scene)
    price = math.hypot(step / math.sqrt(12 * pricing.filter.window), stays_mm) / pricing.noise_mm
    reason = f"{digits(1000 * step, 3)} um per count"
    if stays_mm >= NEGLIGIBLE * pricing.noise_mm:
        reason += f"; the noise is too small to average it out, so {digits(1000 * stays_mm, 3)} um stay in every mean"
    return Effect("ADC steps", price, verdict_of(price), reason, leave_out=without_adc)


EFFECTS: tuple[Callable[[Pricing], Effect], ...] = (
    _shear,
    _contact_width,
    _self_weight,
    _overhang,
    _steps,
    _foundation,
    _dynamics,
    _sensor_curve,
    _adc_steps,
    _gain_error,
    _zero_drift,
    _mounting_tolerance,
    expansion,
    sensor_drift,
)
