"""Prices of effects against textbook values, and the effect on the accuracy limit of leaving one out."""

import math
from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq

from beamtouch_models.accuracy import limit
from beamtouch_models.accuracy.prior import Prior
from beamtouch_models.physics.beam import influence_of, travel_of
from beamtouch_models.physics.motion import first_frequency_hz, sag_mm, slowest_period_ms
from beamtouch_models.pricing.prices import Effect
from beamtouch_models.scene import Scene, load_scene
from beamtouch_models.surface import Surface
from example_scenes import SCENES, paper_scene

NEW_SCENES = {
    "cantilever": set[str](),
    "stepped": {"steps", "shear"},
    "two-spans": {"overhang", "shear"},
    "foundation": {"foundation", "shear"},
    "short-deep": {"shear"},
    "wide-contact": {"contact width"},
}
SOFT_MIDDLE = [{"to_mm": 150, "thickness_mm": 3}, {"to_mm": 200, "thickness_mm": 2.99}, {"to_mm": 400}]
STATED: dict[str, dict[str, dict[str, Any]]] = {
    "shear": {"beam": {"shear_modulus_gpa": 80.0}},
    "contact width": {"contact": {"width_mm": 10.0}},
    "steps": {"beam": {"segments": SOFT_MIDDLE}},
}


def scene_with(*parts: dict[str, dict[str, Any]], **sensors: object) -> Scene:
    """The paper's scene with a force from 2 to 20 N and other values in some of its parts."""
    stated = paper_scene(**sensors).model_dump()
    for part in ({"contact": {"force_n": (2.0, 20.0)}}, *parts):
        for name, values in part.items():
            stated[name] = {**stated[name], **values}
    return Scene.model_validate(stated)


def effects(scene: Scene) -> tuple[Effect, ...]:
    return Surface.of(scene).effects


def physics(scene: Scene) -> Scene:
    return Surface.of(scene).scene


def priced(scene: Scene) -> dict[str, Effect]:
    return {effect.name: effect for effect in effects(scene)}


def price(scene: Scene, name: str) -> float:
    found = priced(scene)[name].price
    assert found is not None
    return found


@pytest.mark.parametrize("name", ["shear", "steps"])
def test_a_barely_negligible_effect_changes_the_accuracy_by_less_than_a_percent(name: str) -> None:
    # At this noise the price is 0.095, so the effect is out; at half of the noise it is in.
    rough = scene_with(STATED[name], noise_percent_of_max=None, noise_mm=0.01)
    noise = 0.01 * price(rough, name) / 0.095
    scene = scene_with(STATED[name], noise_percent_of_max=None, noise_mm=noise)
    assert priced(scene)[name].verdict == "out"
    assert priced(scene_with(STATED[name], noise_percent_of_max=None, noise_mm=noise / 2))[name].verdict == "in"
    smaller, layout = physics(scene), np.array([68.0, 156.0, 244.0, 332.0])
    assert smaller != scene
    # The same contacts with the same noise, estimated with the effect and without it.
    drawn = limit.draw(Prior.of(influence_of(scene), layout, noise), 1000, 1)
    best, without = (
        np.abs(limit.posterior_median_mm(prior, drawn.deflection_mm) - drawn.position_mm).mean()
        for prior in (Prior.of(influence_of(model), layout, noise) for model in (scene, smaller))
    )
    assert abs(without / best - 1) < 0.01


def test_the_prices_of_the_effects_left_out_sum_to_less_than_a_tenth() -> None:
    both = (STATED["shear"], STATED["contact width"])
    rough = scene_with(*both, noise_percent_of_max=None, noise_mm=0.01)
    dearest = max(price(rough, "shear"), price(rough, "contact width"))
    cheapest = min(price(rough, "shear"), price(rough, "contact width"))
    noise = 0.01 * dearest / 0.0999
    assert cheapest / dearest * 0.0999 > 0.001
    judged = priced(scene_with(*both, noise_percent_of_max=None, noise_mm=noise))
    assert sorted(judged[name].verdict for name in ("shear", "contact width")) == ["in", "out"]
    assert any("the effects left out would together exceed" in effect.reason for effect in judged.values())


RIGID = {"youngs_modulus_gpa": None, "width_mm": None, "thickness_mm": None, "flexural_rigidity_n_mm2": 1e7}
SHORT, WHOLE, APART = {"position_mm": (10, 290)}, {"position_mm": (10, 400)}, {"keep_out_mm": [(300, 401)]}
OVERHANG = {"supports": [{"at_mm": 0}, {"at_mm": 300}]}


@pytest.mark.parametrize(
    ("name", "verdict", "parts"),
    [
        ("shear", "not stated", {"beam": RIGID}),
        ("dynamics", "not stated", {"beam": RIGID}),
        # An overhang is left out only if it carries neither loads nor sensors.
        ("overhang", "out", {"beam": OVERHANG, "contact": SHORT, "sensors": APART}),
        ("overhang", "in", {"beam": OVERHANG, "contact": WHOLE, "sensors": APART}),
        ("overhang", "in", {"beam": OVERHANG, "contact": SHORT}),
        # What carries the beam is in at any price.
        (
            "foundation",
            "in",
            {"beam": {"supports": [], "foundation_n_mm2": 0.5}, "sensors": {"noise_percent_of_max": 50}},
        ),
    ],
)
def test_an_effect_is_in_where_it_is_needed(name: str, verdict: str, parts: dict[str, dict[str, Any]]) -> None:
    assert priced(scene_with(parts))[name].verdict == verdict


@pytest.mark.parametrize(
    ("supports", "frequency"),
    [
        # 3 mm of steel, 400 mm long: sqrt(EI/m) = sqrt(11.8125 N m^2 / 0.58875 kg/m) = 4.47925 m^2/s; over 2 pi l^2
        # times 9.8696, 3.5160, 22.3733, 15.4182. Blevins, Formulas for Natural Frequency and Mode Shape, table 8-1.
        ("simply-supported", 43.9754),
        ("cantilever", 15.6663),
        ("fixed-fixed", 99.688),
        ("propped", 68.698),
        # Two equal spans vibrate as two simple spans of half the length; a fixed middle makes two cantilevers.
        ([{"at_mm": 0}, {"at_mm": 200}, {"at_mm": 400}], 4 * 43.9754),
        ([{"at_mm": 200, "kind": "fixed"}], 4 * 15.6663),
    ],
)
def test_first_frequencies_agree_with_published_values(supports: object, frequency: float) -> None:
    scene = scene_with({"beam": {"supports": supports, "density_kg_m3": 7850}})
    assert first_frequency_hz(scene.beam) == pytest.approx(frequency, rel=2e-4)


def test_the_slowest_period_is_that_of_the_beam_with_the_heaviest_load_on_it() -> None:
    # The lowest root of 1 = m w^2 sum phi_k^2 / (w_k^2 - w^2), of a mass m = 20 N / g in the middle of the bench beam,
    # which weighs 0.2355 kg and has modes w_k = k^2 2 pi 43.9754 / s with phi_k^2 = 2 sin^2(k pi / 2) / 0.2355 kg.
    order = np.arange(1, 400, 2)
    squares, phi = (2 * math.pi * 43.9754 * order**2) ** 2, 2 / 0.2355

    def left(square: float) -> float:
        return float(1 - 20 / 9.80665 * square * np.sum(phi / (squares - square)))

    exact_ms = 1e3 * 2 * math.pi / math.sqrt(brentq(left, 1.0, 0.99 * squares[0]))
    scene, _ = load_scene(SCENES / "bench.toml")
    assert exact_ms <= (slowest_period_ms(scene) or 0.0) <= 1.03 * exact_ms


@pytest.mark.parametrize(
    ("name", "period_ms"),
    [
        # The second mode of the conveyor's rail swings at 96 Hz, 4 Hz from the 100 readings per second. It would seem
        # to need 0.25 s for a period, but at 1 % of damping it rings for 1 / (0.01 x 2 pi x 96) = 0.166 s.
        ("conveyor", 166),
        # The paper's beam swings at 43.975 Hz. At 100 readings per second these alternate between two sides, and their
        # amplitude has a period of 1 / (50 - 43.975) s, so that two readings in a row may agree while the beam rings.
        ("paper", 1e3 / (50 - 43.9749)),
    ],
)
def test_a_mode_near_the_rate_of_the_readings_or_half_of_it_seems_slow(name: str, period_ms: float) -> None:
    assert slowest_period_ms(load_scene(SCENES / f"{name}.toml")[0]) == pytest.approx(period_ms, rel=0.01)


def test_the_sag_under_its_own_weight_is_the_published_one() -> None:
    # 5 w l^4 / (384 EI), w = 0.58875 kg/m x 9.80665 m/s^2; Roark, table 8.1 case 2e.
    scene = scene_with({"beam": {"density_kg_m3": 7850}})
    expected = 5 * 0.58875e-3 * 9.80665 * 400**4 / (384 * 1.18125e7)
    assert sag_mm(scene.beam) == pytest.approx(expected, rel=1e-4)
    assert price(scene, "self-weight") == 0
    assert f"{expected:.3g} mm" in priced(scene)["self-weight"].reason


@pytest.mark.parametrize("name", NEW_SCENES)
def test_shipped_scenes_include_the_effects_they_are_named_after(name: str) -> None:
    scene, _ = load_scene(SCENES / f"{name}.toml")
    assert {effect.name for effect in effects(scene) if effect.verdict == "in"} == NEW_SCENES[name]


def test_the_errors_that_calibration_leaves_are_priced_and_belong_to_the_floor() -> None:
    scene = scene_with({"sensors": {"gain_error_percent": 1.0, "zero_drift_mm": 0.01}})
    noise_mm, found = Surface.of(scene).noise.sample_mm, priced(scene)
    # The largest deflection is that in the middle of the beam, 2 % of it the noise: 1 % of gain is half the noise.
    assert found["gain error"].price == pytest.approx(0.5, rel=1e-3)
    assert found["zero drift"].price == pytest.approx(0.01 / noise_mm)
    assert found["gain error"].verdict == found["zero drift"].verdict == "floor"
    taken = priced(scene_with())
    assert "as the scene states none" in taken["gain error"].reason
    assert (taken["gain error"].price, taken["zero drift"].price) == pytest.approx((0.15, 0.2), rel=1e-3)


def test_a_mounting_tolerance_is_modelled_only_where_it_matters() -> None:
    small, large = (scene_with({"sensors": {"mounting_tolerance_mm": tolerance}}) for tolerance in (0.01, 1.0))
    assert priced(small)["mounting tolerance"].verdict == "out"
    assert physics(small).sensors.mounting_tolerance_mm == 0
    assert priced(large)["mounting tolerance"].verdict == "floor"
    assert physics(large).sensors.mounting_tolerance_mm == 1.0
    # Under a load in the middle the slope at a support is 3 times the deflection over the length.
    expected = 3 * travel_of(large).largest_mm / 400 / Surface.of(large).noise.sample_mm
    assert price(large, "mounting tolerance") == pytest.approx(expected, rel=0.05)
