"""The prices of a plate's effects, and the advice for one that bends too far: it holds, and asks for no more."""

import re
from typing import Any

import numpy as np
import pytest

from beamtouch_models import change_scene, read_scene
from beamtouch_models.design.pricing.effect import Effect
from beamtouch_models.design.pricing.of_plates import bends_over_thickness, check_linear
from beamtouch_models.design.scene import Scene
from beamtouch_models.design.scene.plate import Plate
from beamtouch_models.design.surface import resolve
from beamtouch_models.errors import SceneError
from support.surfaces.example_scenes import SCENES

NOISE_MM = 0.002 / 10**0.5
"""That of a mean of ten readings, which come within 50 ms."""


def on_springs(plate: dict[str, Any] | None = None, **tables: dict[str, Any]) -> tuple[Scene, Plate]:
    scene = change_scene(read_scene(SCENES / "plate-on-springs.toml"), plate=plate or {}, **tables)
    assert scene.plate is not None
    return scene, scene.plate


def refusal(scene: Scene, plate: Plate) -> str:
    with pytest.raises(SceneError) as refused:
        check_linear(scene, plate)
    return str(refused.value)


def is_linear(scene: Scene, plate: Plate) -> bool:
    try:
        check_linear(scene, plate)
    except SceneError:
        return False
    return True


def test_the_advice_for_a_plate_that_bends_too_far_is_as_little_as_does() -> None:
    told = refusal(*on_springs({"thickness_mm": 2.2}))
    most = bends_over_thickness(*on_springs({"thickness_mm": 2.2})).most
    found = re.fullmatch(
        r"at 20 N the plate bends by ([\d.]+) times its thickness, with its own weight; beyond 0.5 it stretches, and "
        r"linear theory does not hold: write plate.thickness_mm = ([\d.]+) or more, or end contact.force_n at "
        r"([\d.]+) N",
        told,
    )
    assert found is not None
    assert float(found[1]) == pytest.approx(most, rel=0.03)
    thick, force_n = float(found[2]), float(found[3])
    assert is_linear(*on_springs({"thickness_mm": thick}))
    assert not is_linear(*on_springs({"thickness_mm": 0.97 * thick}))
    for share, linear in ((1.0, True), (1.1, False)):
        lighter = on_springs({"thickness_mm": 2.2}, contact={"force_n": [force_n / 10, share * force_n]})
        assert is_linear(*lighter) == linear


def test_the_bend_of_a_plate_is_in_its_thickness_and_as_the_force() -> None:
    """Over the thickness t it falls as 1/t^4 under a force, as 1/t^3 under the weight, on springs as much stiffer."""
    stiff = {"thickness_mm": 6.0, "support_stiffness_n_per_mm": 120.0}
    thin, thick = bends_over_thickness(*on_springs()), bends_over_thickness(*on_springs(stiff))
    twice = bends_over_thickness(*on_springs(contact={"force_n": [2.0, 40.0]}))
    assert np.allclose(thin.under_force, 16 * thick.under_force, atol=1e-8)
    assert np.allclose(thin.under_weight, 8 * thick.under_weight, atol=1e-8)
    assert np.allclose(twice.under_force, 2 * thin.under_force)
    assert thin.most == np.abs(thin.under_force + thin.under_weight).max()
    bare = {"material": None, "youngs_modulus_gpa": 210.0}
    assert not bends_over_thickness(*on_springs(bare)).under_weight.any()


def test_a_plate_bends_by_its_weight_alike_on_either_side_of_its_middle() -> None:
    weight = bends_over_thickness(*on_springs()).under_weight
    corners = [0, 2, 5, 7]
    left, right, below, above = (weight[-8:][index] for index in (3, 4, 1, 6))
    assert weight[-8:][corners] == pytest.approx(np.full(4, weight[-8]), abs=1e-9)
    assert (left, below) == pytest.approx((right, above))
    assert below > left > weight[-8]  # the longer edge bends further, and corners stay


def effects(scene: Scene) -> dict[str, Effect]:
    return {effect.name: effect for effect in resolve(scene).effects}


@pytest.fixture(scope="module")
def usual() -> dict[str, Effect]:
    return effects(on_springs()[0])


def test_stretching_is_priced_by_the_cube_of_the_bend(usual: dict[str, Effect]) -> None:
    """It takes 0.262 of the square of the bend over the thickness (Timoshenko, table 82)."""
    bend = bends_over_thickness(*on_springs()).most
    effect = usual["large deflection"]
    assert effect.price == pytest.approx(0.262 * bend**3 * 3 / NOISE_MM, rel=1e-6)
    assert effect.verdict == "not modelled"
    assert effect.reason == (
        f"the plate bends by {100 * bend:.2g} % of its thickness; "
        f"stretching makes this some {26.2 * bend**2:.1g} % less (estimated)"
    )
    assert bend < 0.2


def test_what_a_thick_plate_leaves_out_and_cannot_know(usual: dict[str, Effect]) -> None:
    thick = effects(on_springs({"thickness_mm": 6.0, "material": None, "youngs_modulus_gpa": 210.0})[0])
    small = thick["large deflection"]
    assert small.price is not None
    assert small.price < 0.1
    assert small.verdict == "out"
    assert thick["shear"].price == pytest.approx((usual["shear"].price or 0) / 2, rel=1e-3)  # the same moments over 2 t
    assert re.fullmatch(r"the plate bends by [\d.]+ % of its thickness", small.reason)
    assert thick["self-weight"].reason == "constant, so a tare removes it"
    assert thick["heat from one side"].reason == "state plate.material or expansion_um_per_m_k"
    assert thick["dynamics"].reason == "state density_kg_m3 or material"


def test_heat_from_one_side_bows_a_plate_along_its_diagonal(usual: dict[str, Effect]) -> None:
    """12e-6 per kelvin times 500^2 mm^2 over 8 times 3 mm."""
    effect = usual["heat from one side"]
    assert (effect.price, effect.verdict) == (None, "not stated")
    assert effect.reason == (
        "1 K between its faces bows it by 120 um; a rest removes that. Supports are taken to let it slide as it warms"
    )


def test_the_weight_sinks_a_plate_on_its_springs_and_is_tared(usual: dict[str, Effect]) -> None:
    """Of 2.826 kg, each spring bears a quarter; the middle bends a little further."""
    said = re.fullmatch(
        r"constant, so a tare removes it; set the gaps with the plate in place, as it sinks by ([\d.]+) mm",
        usual["self-weight"].reason,
    )
    assert said is not None
    sunk_mm = 7850e-9 * 400 * 300 * 3 * 9.80665 / 4 / 15
    assert sunk_mm < float(said[1]) < sunk_mm + 1.1 * 3 * bends_over_thickness(*on_springs()).under_weight.max()


def test_the_stiffness_of_springs_matters_where_all_supports_are_springs() -> None:
    for plate in ({"support_stiffness_n_per_mm": None}, {"supports": [{"x_mm": 0.0}, {"x_mm": 400.0}]}):
        stated = plate | {"support_stiffness_n_per_mm": None}
        effect = effects(on_springs(stated)[0])["spring stiffness"]
        assert (effect.price, effect.verdict, effect.reason) == (0.0, "out", "not every support is a spring at a point")


def test_shear_is_left_out_where_it_is_small_beside_the_noise(usual: dict[str, Effect]) -> None:
    """The moments of a load stay as they are, and the shear of half a thickness is twice as large."""
    thin = effects(on_springs(sensors={"noise_mm": 0.004})[0])["shear"]
    assert (thin.verdict, thin.reason) == ("out", "the plate is thin (Mindlin's theory, estimated)")
    assert thin.price == pytest.approx((usual["shear"].price or 0) / 2)
    reason = "the plate yields to shear beside its loads (Mindlin's theory, estimated)"
    assert (usual["shear"].verdict, usual["shear"].reason) == ("not modelled", reason)
