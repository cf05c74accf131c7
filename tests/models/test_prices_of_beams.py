"""The prices of a beam's effects and the words that state them, against handbook deflections.

The beam is the paper's, 400 mm of steel of 25 x 3 mm under 10 N, with a noise of 0.01 mm.
"""

from typing import Any

import numpy as np
import pytest

from beamtouch_models.arrays import Floats
from beamtouch_models.design.pricing.effect import Effect
from beamtouch_models.design.scene import Scene, make_scene
from beamtouch_models.design.surface import resolve
from beamtouch_models.errors import SceneError
from beamtouch_models.runtime.metadata_parts import FilterChoice
from models.loaded_string import STRING
from support.surfaces.example_scenes import paper_scene

LENGTH_MM, FORCE_N, NOISE_MM = 400.0, 10.0, 0.01
RIGIDITY = 210e3 * 25 * 3**3 / 12
MIDDLE_MM = FORCE_N * LENGTH_MM**3 / (48 * RIGIDITY)
"""Deflection of the middle under a load there."""
PINNED = [{"at_mm": 0, "slides": False}, {"at_mm": LENGTH_MM, "slides": False}]


def scene_with(parts: dict[str, dict[str, Any]] | None = None, noise_mm: float = NOISE_MM) -> Scene:
    stated = paper_scene(noise_percent_of_max=None, noise_mm=float(noise_mm), range_mm=(1.0, 999.0)).model_dump()
    for name, values in (parts or {}).items():
        stated[name] = {**stated[name], **values}
    return Scene.model_validate(stated)


def priced(name: str, parts: dict[str, dict[str, Any]] | None = None, noise_mm: float = NOISE_MM) -> Effect:
    (effect,) = (each for each in resolve(scene_with(parts, noise_mm)).effects if each.name == name)
    return effect


def told(effect: Effect) -> tuple[str, str]:
    return effect.verdict, effect.reason


def moved_mm(rigidity: Floats) -> Floats:
    """Deflections (loads, sensors) at each 4 mm under 10 N, by the moments of unit loads and the rigidity (1600,)."""
    x, at = (np.arange(1600) + 0.5) / 4, np.arange(4.0, 400, 4)[:, None]
    moment = np.minimum(x * (LENGTH_MM - at), at * (LENGTH_MM - x)) / LENGTH_MM
    deflections: Floats = FORCE_N * (moment / rigidity) @ moment.T / 4
    return deflections


def test_shear_that_no_scene_states_is_estimated_by_poisson_s_ratio_of_metals() -> None:
    """F l / (4 kappa G A) in the middle, with kappa = 5/6 and G = E / 2.6."""
    shear_mm = FORCE_N * LENGTH_MM / (4 * 5 / 6 * 210e3 / 2.6 * 75)
    small, large = priced("shear"), priced("shear", noise_mm=0.001)
    assert (small.price, large.price) == pytest.approx((shear_mm / 0.01, shear_mm / 0.001), rel=1e-3)
    assert told(small) == ("out", "estimated with a Poisson ratio of 0.3")
    reason = "state beam.shear_modulus_gpa to include it, 80.8 at a Poisson ratio of 0.3"
    assert told(large) == ("not modelled", reason)
    assert large.having is not None
    assert large.lacking is not None
    assert large.having.beam.shear_modulus_gpa == pytest.approx(80.769, rel=1e-4)
    assert large.lacking.beam.shear_modulus_gpa is None


def test_shear_that_is_stated_is_in_where_it_counts() -> None:
    shear_mm = FORCE_N * LENGTH_MM / (4 * 5 / 6 * 20e3 * 75)
    for noise_mm, verdict in ((0.002, "in"), (0.02, "out")):
        effect = priced("shear", {"beam": {"shear_modulus_gpa": 20.0}}, noise_mm)
        assert effect.price == pytest.approx(shear_mm / noise_mm, rel=1e-3)
        assert told(effect) == (verdict, "shear modulus 20 GPa")
        assert effect.leave_out is not None
        assert effect.leave_out(scene_with({"beam": {"shear_modulus_gpa": 20.0}})).beam.shear_modulus_gpa is None


def test_without_a_section_shear_cannot_be_estimated() -> None:
    bare = {"youngs_modulus_gpa": None, "width_mm": None, "thickness_mm": None, "flexural_rigidity_n_mm2": RIGIDITY}
    modulus = {"width_mm": None, "thickness_mm": None, "flexural_rigidity_n_mm2": RIGIDITY, "youngs_modulus_gpa": None}
    for beam in (bare, modulus | {"material": "steel"}):
        effect = priced("shear", {"beam": beam})
        assert (effect.price, *told(effect)) == (
            None, "not stated", "state shear_modulus_gpa, width_mm and thickness_mm"
        )  # fmt: skip


@pytest.mark.parametrize(("width_mm", "verdict"), [(40.0, "in"), (4.0, "out")])
def test_a_wide_contact_presses_the_middle_down_less(width_mm: float, verdict: str) -> None:
    """An even load of width w in the middle: F (8 l^3 - 4 l w^2 + w^3) / (384 E I)."""
    less_mm = FORCE_N * (4 * LENGTH_MM * width_mm**2 - width_mm**3) / (384 * RIGIDITY)
    effect = priced("contact width", {"contact": {"width_mm": width_mm, "position_mm": (20, 380)}})
    assert effect.price == pytest.approx(less_mm / NOISE_MM, rel=0.01)
    assert told(effect) == (verdict, f"{width_mm:g} mm")
    point = priced("contact width")
    assert (point.price, *told(point)) == (0.0, "out", "the scene states a point contact")


def test_the_own_weight_is_tared_away_whatever_it_is() -> None:
    light = priced("self-weight")
    assert (light.price, *told(light)) == (0.0, "out", "constant, so a tare removes it")
    heavy = "constant, so a tare removes it; set the gaps with the beam in place, as it sags by 0.163 mm"
    assert told(priced("self-weight", {"beam": {"density_kg_m3": 7850}})) == ("out", heavy)


def test_an_overhang_costs_what_loads_and_sensors_on_it_move() -> None:
    """A load F at the end of an overhang a moves it by F a^2 (s + a) / (3 E I); of spans s of 250 mm beside 150."""
    beam = {"supports": [{"at_mm": 0}, {"at_mm": 250}]}
    tip_mm = FORCE_N * 150**2 * LENGTH_MM / (3 * RIGIDITY)
    effect = priced("overhang", {"beam": beam, "contact": {"position_mm": (10, 400)}})
    assert effect.price == pytest.approx(tip_mm / NOISE_MM, rel=0.06)
    assert told(effect) == ("in", "the beam reaches beyond the supports at 0 and 250 mm")
    left = {"supports": [{"at_mm": 150}, {"at_mm": 400}]}
    mirrored = priced("overhang", {"beam": left, "contact": {"position_mm": (0, 390)}})
    assert mirrored.price == pytest.approx(effect.price, rel=1e-6)
    assert mirrored.reason == "the beam reaches beyond the supports at 150 and 400 mm"
    free: dict[str, dict[str, Any]] = {"contact": {"position_mm": (10, 240)}, "sensors": {"keep_out_mm": [(250, 401)]}}
    unused = priced("overhang", {"beam": beam, **free})
    assert (unused.price, *told(unused)) == (0.0, "out", "no load or sensor on an overhang")
    three = {"supports": [{"at_mm": 0}, {"at_mm": 120}, {"at_mm": 250}]}
    assert told(priced("overhang", {"beam": three, **free})) == told(unused)
    for ends in ("simply-supported", "cantilever"):
        none = priced("overhang", {"beam": {"supports": ends}, "contact": {"position_mm": (10, 390)}})
        assert (none.price, *told(none)) == (0.0, "out", "no overhang")


SEGMENTS = [{"to_mm": 150, "thickness_mm": 3}, {"to_mm": 200, "thickness_mm": 2.7}, {"to_mm": 400, "thickness_mm": 3.2}]


def test_steps_are_priced_beside_a_uniform_beam_of_the_same_mean_compliance() -> None:
    x = (np.arange(1600) + 0.5) / 4
    rigidity = 210e3 * 25 * np.select([x < 150, x < 200], [3.0, 2.7], 3.2) ** 3 / 12
    apart = np.abs(moved_mm(rigidity) - moved_mm(np.full(1600, 1 / np.mean(1 / rigidity)))).max()
    for noise_mm, verdict in ((0.01, "in"), (20 * apart, "out")):
        effect = priced("steps", {"beam": {"segments": SEGMENTS}}, noise_mm)
        assert effect.price == pytest.approx(apart / noise_mm, rel=2e-3)
        assert told(effect) == (verdict, "beside a uniform beam that is as flexible on average")
        assert effect.leave_out is not None
    assert (priced("steps").price, *told(priced("steps"))) == (0.0, "out", "a single section")
    sheared = priced("steps", {"beam": {"segments": SEGMENTS, "shear_modulus_gpa": 80.0}}, 20 * apart)
    said = "beside a uniform beam that is as flexible on average; included, because shear depends on the sections"
    assert told(sheared) == ("in", said)
    assert sheared.price == pytest.approx(0.05, rel=2e-3)
    assert sheared.leave_out is None


def test_a_foundation_is_priced_by_what_it_bears() -> None:
    """A weak one, k, bears what the beam of the supports moves: of the middle, k times the sum of its squares."""
    k = 1e-4
    compliance = moved_mm(np.full(1600, RIGIDITY)) / FORCE_N
    less_mm = FORCE_N * k * 4 * (compliance @ compliance).max()
    effect = priced("foundation", {"beam": {"foundation_n_mm2": k}})
    assert effect.price == pytest.approx(less_mm / NOISE_MM, rel=0.02)
    assert told(effect) == ("in", "0.0001 N/mm per mm")
    alone = {"beam": {"supports": [], "foundation_n_mm2": 0.5}}
    bears = priced("foundation", alone)
    assert told(bears) == ("in", "0.5 N/mm per mm; nothing else supports the beam")
    assert bears.price == pytest.approx((priced("gain error", alone).price or 0) / 0.003)
    assert (priced("foundation").price, *told(priced("foundation"))) == (0.0, "out", "no foundation")


def test_gains_zeros_and_their_drift_are_priced_as_stated_or_assumed() -> None:
    """Assumed: 0.3 % of the deflection, a fifth of the noise of a reading, and all of it a minute."""
    assumed = [priced(name) for name in ("gain error", "zero drift", "drift in a minute")]
    assert [effect.price for effect in assumed] == pytest.approx([0.003 * MIDDLE_MM / NOISE_MM, 0.2, 0.5])
    end = "each by itself by 0.5 times that; each rest corrects them, and intervals widen while a contact lasts"
    assert [told(effect) for effect in assumed] == [
        ("floor", "calibration leaves an error of 0.3 % of the deflection (assumed)"),
        ("floor", "2 um since the last tare (assumed)"),
        ("floor", f"zeros drift by 10 um a minute together (assumed), {end}"),
    ]
    errors = {"gain_error_percent": 1.51234, "zero_drift_mm": 0.03}
    parts = {"sensors": errors, "environment": {"drift_um_per_min": 40.0}}
    stated = [priced(name, parts) for name in ("gain error", "zero drift", "drift in a minute")]
    assert [effect.price for effect in stated] == pytest.approx([0.0151234 * MIDDLE_MM / NOISE_MM, 3.0, 2.0])
    assert [told(effect) for effect in stated] == [
        ("floor", "calibration leaves an error of 1.51 % of the deflection"),
        ("floor", "30 um since the last tare"),
        ("floor", f"zeros drift by 40 um a minute together, {end}"),
    ]
    still = priced("drift in a minute", {"environment": {"drift_um_per_min": 0.0}})
    assert (still.price, *told(still)) == (0.0, "out", "the scene states that zeros do not drift")


def test_a_sensor_beside_its_place_sees_the_slope_of_the_beam() -> None:
    """F l^2 / (16 E I) at an end, under a load in the middle."""
    effect = priced("mounting tolerance", {"sensors": {"mounting_tolerance_mm": 2.0}})
    assert effect.price == pytest.approx(2 * FORCE_N * LENGTH_MM**2 / (16 * RIGIDITY) / NOISE_MM, rel=0.05)
    assert told(effect) == ("floor", "+- 2 mm along the beam; `calibrate` finds the true positions")
    tiny = priced("mounting tolerance", {"sensors": {"mounting_tolerance_mm": 0.01}})
    assert told(tiny) == ("out", "+- 0.01 mm along the beam; `calibrate` finds the true positions")
    assert tiny.leave_out is not None
    assert tiny.leave_out(scene_with({"sensors": {"mounting_tolerance_mm": 0.01}})).sensors.mounting_tolerance_mm == 0
    exact = priced("mounting tolerance")
    assert (exact.price, *told(exact)) == (0.0, "out", "the scene states no tolerance")


def test_an_influence_of_ones_own_that_is_no_table_leaves_nothing_open() -> None:
    contact, sensors = {"force_n": (2.0, 20.0), "position_mm": (10.0, 390.0)}, {"noise_mm": NOISE_MM}
    effects = resolve(make_scene(contact=contact, sensors=sensors), influence=STRING).effects
    each = {effect.name: (effect.price, *told(effect)) for effect in effects}
    assert each["interpolation"] == (0.0, "out", "the influence function is known everywhere")
    assert each["repeatability"] == (0.0, "out", "the influence function is exact")


def test_what_the_scene_does_not_state_of_its_sensors_is_said() -> None:
    assert told(priced("sensor curve", {"sensors": {"range_mm": (1.5, 9)}})) == (
        "not stated", "taken as linear over 1.5..9 mm; `calibrate` measures it"
    )  # fmt: skip
    assert told(priced("ADC steps")) == ("not stated", "state sensors.adc_bits")
    assert told(priced("sensor drift")) == (
        "not stated", "state environment.temperature_range_k and sensors.drift_um_per_k"
    )  # fmt: skip
    warm = {"environment": {"temperature_range_k": (-5.0, 25.0)}}
    assert told(priced("sensor drift", warm)) == ("not stated", "state sensors.drift_um_per_k")


@pytest.mark.parametrize("window", [1, 9])
def test_steps_of_an_adc_average_out_as_far_as_noise_moves_the_readings(window: int) -> None:
    """A step of q is an even error of q / sqrt(12) in each reading; here noise is twice the step."""
    step_mm = 3 / (0.8 * 1023)
    scene = scene_with({"sensors": {"adc_bits": 10, "range_mm": (1, 4)}}, 2 * step_mm)
    chosen = FilterChoice(kind="moving-average", window=window) if window > 1 else FilterChoice()
    (effect,) = (each for each in resolve(scene, chosen=chosen).effects if each.name == "ADC steps")
    # Both the steps' error and the noise fall alike, so the price is the same for each filter.
    assert effect.price == pytest.approx((1 / 12) ** 0.5 / (4 + 1 / 12) ** 0.5, rel=1e-3)
    assert told(effect) == ("floor", "3.67 um per count")


def test_a_drift_with_the_temperature_is_priced_beside_the_other_drift() -> None:
    """Of two independent temperatures, even over 30 K, the difference deviates by 30 / sqrt(6)."""
    parts: dict[str, dict[str, Any]] = {
        "sensors": {"drift_um_per_k": 0.8},
        "environment": {"temperature_range_k": (-5.0, 25.0)},
    }
    effect = priced("sensor drift", parts)
    assert effect.price == pytest.approx(0.8e-3 * 30 / 6**0.5 / NOISE_MM)
    said = "up to 24 um after a tare at the other end of 30 K, 9.8 um as a standard deviation, "
    assert told(effect) == ("floor", f"{said}4.9 times zero drift")
    exact = priced("sensor drift", {**parts, "sensors": {"drift_um_per_k": 0.8, "zero_drift_mm": 0.0}})
    assert exact.reason == f"{said}beside no zero drift"


def test_a_beam_that_can_lengthen_needs_no_temperature() -> None:
    effect = priced("expansion")
    assert (effect.price, *told(effect)) == (
        0.0,
        "out",
        "the beam can lengthen: at most one support holds it lengthwise",
    )


BUCKLES_K = (np.pi / LENGTH_MM) ** 2 * (3**2 / 12) / 12e-6
"""Of a pinned beam of 12 um/(m K), whatever its modulus: pi^2 I / (A l^2) over its expansion."""


def held(range_k: tuple[float, float] | None, noise_mm: float = NOISE_MM, **beam: object) -> Effect:
    stated = {"supports": PINNED, "expansion_um_per_m_k": 12.0} | beam
    environment = {} if range_k is None else {"environment": {"temperature_range_k": range_k}}
    return priced("expansion", {"beam": stated, **environment}, noise_mm)


def test_a_held_beam_says_what_is_missing_to_price_its_expansion() -> None:
    assert told(held(None, expansion_um_per_m_k=None)) == (
        "not stated", "state beam.material or expansion_um_per_m_k, and thickness_mm"
    )  # fmt: skip
    where = f"held at 0 and 400 mm, it buckles {BUCKLES_K:.3g} K above its mounting"
    assert told(held(None)) == ("not stated", f"state environment.temperature_range_k; {where}")


def test_compression_softens_a_held_beam_by_what_timoshenko_found() -> None:
    """Deflections grow by about 1 / (1 - N / N_cr), and N is the share of the warmth at which the beam buckles."""
    low_k, high_k = -0.1 * BUCKLES_K, 0.2 * BUCKLES_K
    effect = held((low_k, high_k))
    assert effect.price == pytest.approx(0.25 * MIDDLE_MM / NOISE_MM, rel=0.04)
    force_n = [210e3 * 75 * 12e-6 * each for each in (low_k, high_k)]
    start = f"held at 0 and 400 mm, it buckles {BUCKLES_K:.3g} K above its mounting; "
    assert effect.verdict == "not modelled"
    forces = f"{force_n[0]:.3g}..{force_n[1]:.3g} N of compression"
    assert effect.reason == f"{start}{forces} change the largest deflection by -9.1..+25 %"
    assert told(held((low_k, high_k), 3 * MIDDLE_MM))[0] == "out"
    near = held((0.0, 0.6 * BUCKLES_K))
    assert near.reason.endswith("; buckling is near, so let one support slide")


def test_a_beam_that_would_buckle_is_refused_with_what_it_bears() -> None:
    said = (
        f"environment.temperature_range_k: 9 K above its mounting the beam buckles, as it is held at 0 and 400 mm and "
        f"bears {BUCKLES_K:.3g} K; let one support slide (slides = true), or mount it warmer"
    )
    with pytest.raises(SceneError) as refused:
        held((-5.0, 9.0))
    assert str(refused.value) == said


def test_ringing_that_has_not_decayed_behind_the_filter_is_priced() -> None:
    """Without a filter, all of it: the largest deflection."""
    missing = "state density_kg_m3 or material, with width_mm and thickness_mm"
    assert told(priced("dynamics")) == ("not stated", missing)
    heavy = priced("dynamics", {"beam": {"density_kg_m3": 7850}})
    assert heavy.price == pytest.approx(MIDDLE_MM / NOISE_MM)
    said = "rings at 44 Hz, damped by 1 % (assumed); intervals are wide until it is still"
    assert told(heavy) == ("not modelled", said)
    damped = priced("dynamics", {"beam": {"density_kg_m3": 7850, "damping_ratio": 0.04}}, 20 * MIDDLE_MM)
    assert told(damped) == ("out", "rings at 44 Hz, damped by 4 %; it has decayed once the filter has settled")
    assert damped.price == pytest.approx(0.05)
