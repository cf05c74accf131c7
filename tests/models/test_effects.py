"""The prices of effects as `explain` states them, against textbook values."""

from typing import Any

import pytest

from beamtouch_models import frequency_hz
from beamtouch_models.design.scene import Scene, load_scene
from support.surfaces.example_scenes import SCENES, paper_scene

from .conftest import Explain

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


def test_the_prices_of_the_effects_left_out_sum_to_less_than_a_tenth(explain: Explain) -> None:
    both = (STATED["shear"], STATED["contact width"])
    rough = scene_with(*both, noise_percent_of_max=None, noise_mm=0.01, range_mm=(1.0, 9.0))
    cheapest, dearest = sorted(explain(rough)["effects"][name]["price"] for name in ("shear", "contact width"))
    noise = 0.01 * dearest / 0.0999
    assert cheapest / dearest * 0.0999 > 0.001
    judged = explain(scene_with(*both, noise_percent_of_max=None, noise_mm=noise, range_mm=(1.0, 9.0)))["effects"]
    assert sorted(judged[name]["verdict"] for name in ("shear", "contact width")) == ["in", "out"]
    assert any("the effects left out would together exceed" in one["reason"] for one in judged.values())


RIGID = {"youngs_modulus_gpa": None, "width_mm": None, "thickness_mm": None, "flexural_rigidity_n_mm2": 1e7}
SHORT, WHOLE, APART = (
    {"position_mm": (10, 290)},
    {"position_mm": (10, 400), "force_n": (1.0, 10.0)},
    {"keep_out_mm": [(300, 401)]},
)
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
def test_an_effect_is_in_where_it_is_needed(
    explain: Explain, name: str, verdict: str, parts: dict[str, dict[str, Any]]
) -> None:
    assert explain(scene_with(parts))["effects"][name]["verdict"] == verdict


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
    assert frequency_hz(scene) == pytest.approx(frequency, rel=2e-4)


def test_the_sag_under_its_own_weight_is_the_published_one(explain: Explain) -> None:
    # 5 w l^4 / (384 EI), w = 0.58875 kg/m x 9.80665 m/s^2; Roark, table 8.1 case 2e.
    weight = explain(scene_with({"beam": {"density_kg_m3": 7850}}))["effects"]["self-weight"]
    expected = 5 * 0.58875e-3 * 9.80665 * 400**4 / (384 * 1.18125e7)
    assert weight["price"] == 0
    assert f"sags by {expected:.3g} mm" in weight["reason"]


@pytest.mark.parametrize("name", NEW_SCENES)
def test_shipped_scenes_include_the_effects_they_are_named_after(explain: Explain, name: str) -> None:
    scene, _ = load_scene(SCENES / f"{name}.toml")
    assert {effect for effect, one in explain(scene)["effects"].items() if one["included"]} == NEW_SCENES[name]


def test_the_errors_that_calibration_leaves_are_priced_and_belong_to_the_floor(explain: Explain) -> None:
    told = explain(scene_with({"sensors": {"gain_error_percent": 1.0, "zero_drift_mm": 0.01}}))
    gain, zero = told["effects"]["gain error"], told["effects"]["zero drift"]
    # The largest deflection is that in the middle of the beam, 2 % of it the noise: 1 % of gain is half the noise.
    assert gain["price"] == pytest.approx(0.5, rel=1e-3)
    assert zero["price"] == pytest.approx(0.01 / told["noise_mm"])
    assert gain["verdict"] == zero["verdict"] == "floor"
    taken = explain(scene_with())["effects"]
    assert "(assumed)" in taken["gain error"]["reason"]
    assert (taken["gain error"]["price"], taken["zero drift"]["price"]) == pytest.approx((0.15, 0.2), rel=1e-3)


def test_a_mounting_tolerance_is_modelled_only_where_it_matters(explain: Explain) -> None:
    small, large = (explain(scene_with({"sensors": {"mounting_tolerance_mm": tolerance}})) for tolerance in (0.01, 1.0))
    assert small["effects"]["mounting tolerance"]["verdict"] == "out"
    assert large["effects"]["mounting tolerance"]["verdict"] == "floor"
    # Under a load in the middle the slope at a support is 3 times the deflection over the length.
    expected = 3 * large["max_deflection_mm"] / 400 / large["noise_mm"]
    assert large["effects"]["mounting tolerance"]["price"] == pytest.approx(expected, rel=0.05)
