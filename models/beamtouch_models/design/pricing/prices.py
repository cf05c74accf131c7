"""The price of each physical effect in a scene, and the scene without its negligible effects.

The price of an effect is the largest change in deflection that it causes at any allowed sensor position, over the
scene's loads at the largest force, in units of the noise of a sample. Effects are left out, cheapest first, while the
sum of their prices stays under a tenth. The sum bounds their joint effect.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from beamtouch_common.digits import digits
from beamtouch_common.errors import InputError
from beamtouch_common.units import fine
from beamtouch_models.arrays import Floats
from beamtouch_models.design.physics import motion
from beamtouch_models.design.physics.axial import held, holding_mm
from beamtouch_models.design.physics.influence_function import InfluenceFunction
from beamtouch_models.design.pricing.effect import NEGLIGIBLE, Effect, Pricing, Verdict, effect_stated, verdict_of
from beamtouch_models.design.pricing.noise import ReadingErrors
from beamtouch_models.design.pricing.of_plates import OF_PLATES
from beamtouch_models.design.pricing.of_solids import contact_width, dynamics
from beamtouch_models.design.scene import Scene, change_scene
from beamtouch_models.errors import SceneError
from beamtouch_models.filters.walk import OWN
from beamtouch_models.numbers import at_most
from beamtouch_models.places import positions_of
from beamtouch_models.runtime.metadata_parts import FilterChoice

MAX_POSITIONS = 401
"""Largest number of sensor positions at which an effect is priced, evenly chosen from the allowed ones."""
NEAR = 0.5
"""Share of the critical force from which buckling is near: an imperfect beam bows there (Southwell)."""
POISSON_RATIO = 0.3
"""Value of most metals; it gives the shear modulus if the scene does not state one."""


without_shear = partial(change_scene, beam={"shear_modulus_gpa": None})
without_foundation = partial(change_scene, beam={"foundation_n_mm2": None})
"""Raises InputError if nothing else supports the beam."""
without_tolerance = partial(change_scene, sensors={"mounting_tolerance_mm": 0.0})
"""The scene with sensors at exactly known positions."""


def without_steps(scene: Scene) -> Scene:
    """Return the scene with a prismatic beam that has the mean compliance of the beam."""
    sections = scene.beam.sections
    starts = [0.0, *(section.to_mm for section in sections[:-1])]
    shares = [(section.to_mm - start) / scene.beam.length_mm for section, start in zip(sections, starts, strict=True)]
    compliance = sum(share / section.rigidity_n_mm2 for share, section in zip(shares, sections, strict=True))
    dropped = dict.fromkeys(("youngs_modulus_gpa", "shear_modulus_gpa", "width_mm", "thickness_mm"))
    return change_scene(scene, beam={**dropped, "segments": (), "flexural_rigidity_n_mm2": 1 / compliance})


def _shear(pricing: Pricing) -> Effect:
    scene, beam = pricing.scene, pricing.scene.beam
    if beam.shear_modulus_gpa is not None:
        return effect_stated(pricing, "shear", f"shear modulus {beam.shear_modulus_gpa:g} GPa", without_shear)
    if beam.modulus_gpa is None or any(section.area_mm2 is None for section in beam.sections):
        return Effect("shear", None, "not stated", "state shear_modulus_gpa, width_mm and thickness_mm")
    modulus = beam.modulus_gpa / (2 * (1 + POISSON_RATIO))
    having = change_scene(scene, beam={"shear_modulus_gpa": modulus})
    price = pricing.price(having, scene)
    if price < NEGLIGIBLE:
        reason = f"estimated with a Poisson ratio of {POISSON_RATIO:g}"
        return Effect("shear", price, "out", reason, having, scene)
    reason = f"state beam.shear_modulus_gpa to include it, {digits(modulus, 3)} at a Poisson ratio of {POISSON_RATIO:g}"
    return Effect("shear", price, "not modelled", reason, having, scene)


def _self_weight(pricing: Pricing) -> Effect:
    # Deflections are linear in the load: after a tare, a contact adds the same deflection with or without the weight.
    sag = motion.sag_mm(pricing.scene.beam)
    told = "" if sag is None else f"; set the gaps with the beam in place, as it sags by {digits(sag, 3)} mm"
    return Effect("self-weight", 0.0, "out", f"constant, so a tare removes it{told}")


def _overhang(pricing: Pricing) -> Effect:
    scene, supports = pricing.scene, pricing.scene.beam.support_list
    places = [support.at_mm for support in supports]
    if len(places) < 2 or (places[0] == 0 and places[-1] == scene.beam.length_mm):
        return Effect("overhang", 0.0, "out", "no overhang")
    positions = positions_of(pricing.load_mm), positions_of(pricing.sensor_mm)
    off_loads, off_sensors = ((mm < places[0]) | (mm > places[-1]) for mm in positions)
    price = pricing.in_noise(pricing.stated_mm[off_loads[:, None] | off_sensors])
    if price == 0:
        return Effect("overhang", 0.0, "out", "no load or sensor on an overhang")
    return Effect(
        "overhang", price, "in", f"the beam reaches beyond the supports at {places[0]:g} and {places[-1]:g} mm"
    )


def _steps(pricing: Pricing) -> Effect:
    scene = pricing.scene
    if len({section.rigidity_n_mm2 for section in scene.beam.sections}) == 1:
        return Effect("steps", 0.0, "out", "a single section")
    # The prismatic beam has no section for shear to depend on, so compare the two without shear.
    having, lacking = without_shear(scene), without_steps(scene)
    price = pricing.price(having, lacking)
    reason = "beside a uniform beam that is as flexible on average"
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
        without_foundation(scene)
    except InputError:
        return Effect("foundation", pricing.price_of_all, "in", f"{reason}; nothing else supports the beam", scene)
    return effect_stated(pricing, "foundation", reason, without_foundation)


def _gain_error(pricing: Pricing) -> Effect:
    gain = pricing.readings.gain
    assumed = "" if pricing.scene.sensors.gain_error_percent is not None else " (assumed)"
    reason = f"calibration leaves an error of {digits(100 * gain, 3)} % of the deflection{assumed}"
    return Effect("gain error", gain * pricing.price_of_all, "floor", reason)


def _zero_drift(pricing: Pricing) -> Effect:
    zero_mm = pricing.readings.zero_mm
    assumed = "" if pricing.scene.sensors.zero_drift_mm is not None else " (assumed)"
    reason = f"{fine(zero_mm, pricing.scene.unit)} since the last tare{assumed}"
    return Effect("zero drift", pricing.in_noise(np.array([zero_mm])), "floor", reason)


def _drift_under_a_load(pricing: Pricing) -> Effect:
    """Price what zeros drift by themselves in a contact of a minute; what they drift together is mostly force."""
    name, rate_mm = "drift in a minute", pricing.readings.drift_mm_per_min
    if rate_mm == 0:
        return Effect(name, 0.0, "out", "the scene states that zeros do not drift")
    assumed = "" if pricing.scene.environment.drift_um_per_min is not None else " (assumed)"
    reason = (
        f"zeros drift by {fine(rate_mm, pricing.scene.unit)} a minute together{assumed}, each by itself by {OWN:g} "
        "times that; each rest corrects them, and intervals widen while a contact lasts"
    )
    return Effect(name, pricing.in_noise(np.array([OWN * rate_mm])), "floor", reason)


def _mounting_tolerance(pricing: Pricing) -> Effect:
    tolerance_mm = pricing.scene.sensors.mounting_tolerance_mm
    if tolerance_mm == 0:
        return Effect("mounting tolerance", 0.0, "out", "the scene states no tolerance")
    moved = pricing.influence.deviation(pricing.sensor_mm, pricing.load_mm, tolerance_mm)[
        ..., : pricing.influence.extent.axes
    ]
    price = pricing.in_noise(pricing.influence.force_n[1] * moved)
    on_beam = pricing.influence.extent.axes == 1  # no other structure is calibrated
    along = "the beam; `calibrate` finds the true positions" if on_beam else "each axis"
    reason = f"+- {tolerance_mm:g} mm along {along}"
    verdict: Verdict = "out" if price < NEGLIGIBLE else "floor"
    return Effect("mounting tolerance", price, verdict, reason, leave_out=without_tolerance)


def _sensor_curve(pricing: Pricing) -> Effect:
    low, high = pricing.scene.sensors.range_mm
    span = f"{low:g}..{high:g} {pricing.scene.unit}"
    measured = "; `calibrate` measures it" if pricing.influence.extent.axes == 1 else ""
    return Effect("sensor curve", None, "not stated", f"taken as linear over {span}{measured}")


def _adc_steps(pricing: Pricing) -> Effect:
    scene = pricing.scene
    if scene.sensors.adc_bits is None:
        return Effect("ADC steps", None, "not stated", "state sensors.adc_bits")
    # Standard deviations, like the noise that they are compared to. The rounding errors of readings are independent
    # only as far as noise moves the readings over the steps.
    step, stays_mm = pricing.readings.step_mm, pricing.readings.rounding_mm
    price = math.hypot(step / math.sqrt(12 * pricing.filter.window), stays_mm) / pricing.noise_mm
    reason = f"{fine(step, scene.unit)} per count"
    if stays_mm >= NEGLIGIBLE * pricing.noise_mm:
        reason += f"; the noise is too small to average it out, so {fine(stays_mm, scene.unit)} stay in every mean"
    return Effect("ADC steps", price, "floor", reason)


def _expansion(pricing: Pricing) -> Effect:
    """Price the axial force in a held beam, at both ends of the temperature range; SceneError if the beam buckles."""
    name, scene = "expansion", pricing.scene
    holding, range_k = holding_mm(scene.beam), scene.environment.temperature_range_k
    if len(holding) < 2:
        return Effect(name, 0.0, "out", "the beam can lengthen: at most one support holds it lengthwise")
    restrained = held(scene.beam)
    if restrained is None:
        return Effect(name, None, "not stated", "state beam.material or expansion_um_per_m_k, and thickness_mm")
    buckles = f"it buckles {digits(restrained.buckles_k, 3)} K above its mounting"
    where = f"held at {holding[0]:g} and {holding[-1]:g} mm, {buckles}"
    if range_k is None:
        return Effect(name, None, "not stated", f"state environment.temperature_range_k; {where}")
    if range_k[1] >= restrained.buckles_k:
        raise SceneError(
            f"environment.temperature_range_k: {range_k[1]:g} K above its mounting the beam buckles, as it is held at "
            f"{holding[0]:g} and {holding[-1]:g} mm and bears {digits(restrained.buckles_k, 3)} K; let one support "
            "slide (slides = true), or mount it warmer"
        )
    change = [restrained.change(one_k) for one_k in range_k]
    price = pricing.price_of_all * max(map(abs, change))
    forces = "..".join(digits(restrained.force_n_per_k * one_k, 3) for one_k in range_k)
    percent = "..".join(f"{100 * share:+.2g}" for share in change)
    reason = f"{where}; {forces} N of compression change the largest deflection by {percent} %"
    if price < NEGLIGIBLE:
        return Effect(name, price, "out", reason)
    if range_k[1] > NEAR * restrained.buckles_k:
        reason += "; buckling is near, so let one support slide"
    return Effect(name, price, "not modelled", reason, scene)


def _sensor_drift(pricing: Pricing) -> Effect:
    """Price the drift of the sensors with the temperature beside the other drift of their zeros."""
    name, sensors, range_k = "sensor drift", pricing.scene.sensors, pricing.scene.environment.temperature_range_k
    if range_k is None:
        return Effect(name, None, "not stated", "state environment.temperature_range_k and sensors.drift_um_per_k")
    if sensors.drift_um_per_k is None:
        return Effect(name, None, "not stated", "state sensors.drift_um_per_k")
    drift_mm, zero_mm = pricing.readings.warmth_mm, pricing.readings.zero_mm
    span_k = range_k[1] - range_k[0]
    beside = f"{digits(drift_mm / zero_mm, 2)} times" if zero_mm else "beside no"
    reason = (
        f"up to {fine(1e-3 * sensors.drift_um_per_k * span_k, pricing.scene.unit)} after a tare at the other end of "
        f"{span_k:g} K, {fine(drift_mm, pricing.scene.unit)} as a standard deviation, {beside} zero drift"
    )
    return Effect(name, pricing.in_noise(np.array([drift_mm])), "floor", reason)


def _interpolation(pricing: Pricing) -> Effect:
    """Price what the table of an influence leaves open between its places."""
    name, table = "interpolation", pricing.influence.interpolation
    if table is None:
        return Effect(name, 0.0, "out", "the influence function is known everywhere")
    deviation = table.deviation_at(pricing.sensor_mm, pricing.load_mm)
    price = pricing.in_noise(pricing.influence.force_n[1] * deviation)
    if pricing.scene.measured is not None and pricing.scene.measured.theory is not None:
        return Effect(name, price, "floor", "by which the theory misses the loads")
    reason = f"of a table of places {digits(table.spacing_mm, 3)} mm apart"
    if price > 1 and not math.isnan(table.order):
        needed_mm = table.spacing_mm * (1 / price) ** (1 / table.order)
        reason += f"; with one at every {at_most(needed_mm):g} mm it would be no larger than the noise"
    return Effect(name, price, "floor", reason)


def _repeatability(pricing: Pricing) -> Effect:
    """Price by how much the deflection differs when a load is put on anew."""
    name, table = "repeatability", pricing.influence.interpolation
    if table is None or table.repeats is None:
        return Effect(name, 0.0, "out", "the influence function is exact")
    scatter = pricing.influence.force_n[1] * table.repeats(pricing.sensor_mm, pricing.load_mm)
    return Effect(
        name, pricing.in_noise(scatter), "floor", "loads that are put on anew at the same place differ by this"
    )


OF_BEAMS: tuple[Callable[[Pricing], Effect], ...] = (
    _shear,
    contact_width,
    _self_weight,
    _overhang,
    _steps,
    _foundation,
    dynamics,
)
OF_SENSORS: tuple[Callable[[Pricing], Effect], ...] = (
    _sensor_curve,
    _adc_steps,
    _gain_error,
    _zero_drift,
    _drift_under_a_load,
    _mounting_tolerance,
)
OF_HEAT = _expansion, _sensor_drift
OF_TABLES = _interpolation, _repeatability


def effects_of(
    scene: Scene, influence: InfluenceFunction, chosen: FilterChoice, readings: ReadingErrors, allowed_mm: Floats
) -> tuple[Effect, ...]:
    """Price every effect of a scene, in the noise of a sample.

    Parameters
    ----------
    scene, influence : the scene, and its influence function as stated
    chosen, readings : the filter of its model, and the errors of its readings
    allowed_mm : (places, axes) where sensors may stand, ascending

    Raises
    ------
    SceneError
        The scene cannot be computed, or its noise, which must not be 0, is too small to price effects in.
    """
    indices = np.linspace(0, len(allowed_mm) - 1, min(len(allowed_mm), MAX_POSITIONS)).round().astype(np.intp)
    pricing = Pricing(scene, influence, chosen, readings, allowed_mm[indices])
    if scene.has_beam:
        priced = (*OF_BEAMS, *OF_SENSORS, *OF_HEAT)
    elif scene.plate is not None:
        priced = (*OF_PLATES, *OF_SENSORS, _sensor_drift)
    else:
        priced = (*OF_TABLES, *OF_SENSORS, _sensor_drift)
    return _include_too_many([price(pricing) for price in priced])


def without_negligible(scene: Scene, effects: Sequence[Effect]) -> Scene:
    """Return a scene without its negligible effects; its errors of readings are those of the scene as stated."""
    for effect in effects:
        if effect.verdict == "out" and effect.leave_out:
            scene = effect.leave_out(scene)
    return scene


def _include_too_many(effects: list[Effect]) -> tuple[Effect, ...]:
    """Include the most expensive negligible effects again, until the prices of the rest sum to less than the limit."""
    judged, total = {effect.name: effect for effect in effects}, 0.0
    left_out = [effect for effect in effects if effect.verdict == "out" and effect.leave_out]
    for effect in sorted(left_out, key=lambda effect: effect.price or 0.0):
        total += effect.price or 0.0
        if total >= NEGLIGIBLE:
            reason = f"{effect.reason}; included, as the effects left out would together exceed {NEGLIGIBLE:g}"
            judged[effect.name] = replace(effect, verdict="in", reason=reason)
    return tuple(judged.values())
