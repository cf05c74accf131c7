"""Obvious mistakes in a scene's places and materials are refused with what to write instead."""

import pytest

from beamtouch_common.errors import InputError
from beamtouch_models.scene import parse_scene
from example_scenes import SCENES

BENCH = (SCENES / "bench.toml").read_text()


def refusal(in_place_of: str, stated: str) -> str:
    assert in_place_of in BENCH
    with pytest.raises(InputError) as caught:
        parse_scene(BENCH.replace(in_place_of, stated, 1), "x.toml")
    return str(caught.value)


@pytest.mark.parametrize(
    ("in_place_of", "stated", "said"),
    [
        ("[1, 399]", "[0.001, 0.399]", "contact.position_mm = [0.001, 0.399] is next to the left end of the beam"),
        ('"simply-supported"', "[{ at_mm = 0 }, { at_mm = 0.4 }]", "if it is in metres, write [0, 400]"),
        ("count = 4", "count = 4\nfixed_mm = [0.1, 0.3]", "if it is in metres, write [100, 300]"),
        ("count = 4", "count = 4\nkeep_out_mm = [[9, 12], [0.1, 0.3]]", "sensors.keep_out_mm[1] = [0.1, 0.3] is next"),
        ("count = 4", "count = 4\nkeep_out_mm = [[400, 480]]", "has [400, 480], off the beam, 0..400 mm"),
        (
            "count = 4",
            "count = 4\nfixed_mm = [99]\nkeep_out_mm = [[90, 110]]",
            "fixed_mm has 99 mm, where a housing of size_mm = 12 reaches into [90, 110] of keep_out_mm; move",
        ),
        ("[1, 399]", "[1, 399]\nwidth_mm = 400", "contact.width_mm = 400 must be less than beam.length_mm = 400"),
        ("count = 4", "count = [5, 3]", "sensors.count = [5, 3]: the first must not exceed the second"),
    ],
)
def test_a_place_that_cannot_be_meant_is_refused(in_place_of: str, stated: str, said: str) -> None:
    assert said in refusal(in_place_of, stated)


@pytest.mark.parametrize(
    ("stated", "said"),
    [
        ("210000", "if it is in MPa, write 210"),
        ("30e6", "if it is in psi, write 206.8"),
        ("3e9", "if it is in Pa, write 3"),
        ("2.1e11", "if it is in Pa, write 210"),
        ("1e300", "is more than any material has; state it in GPa"),
        ("210\nshear_modulus_gpa = 210", "beam.shear_modulus_gpa = 210 must be less than Young's modulus, 210"),
        ("210\nexpansion_um_per_m_k = 12000", "is more than any material has; state it in um/(m K)"),
    ],
)
def test_a_modulus_gets_the_unit_that_a_material_can_have(stated: str, said: str) -> None:
    assert said in refusal("youngs_modulus_gpa = 210", f"youngs_modulus_gpa = {stated}")


def test_a_heavier_density_than_that_of_osmium_is_refused() -> None:
    assert "state it in kg/m3" in refusal("= 7850", "= 7850000")


@pytest.mark.parametrize(
    ("in_place_of", "stated"),
    [
        ("count = 4", "count = 4\nfixed_mm = [84]\nkeep_out_mm = [[90, 110]]"),
        ("count = 4", "count = 4\nkeep_out_mm = [[-9, 30], [390, 480]]"),
        ("[1, 399]", "[0, 0.5]"),
        ("[1, 399]", "[1, 399]\nwidth_mm = 399"),
        ('"simply-supported"', '[{ at_mm = 0, kind = "fixed" }]'),
        ("youngs_modulus_gpa = 210", "youngs_modulus_gpa = 210\nshear_modulus_gpa = 80"),
    ],
)
def test_a_place_that_can_be_meant_is_taken(in_place_of: str, stated: str) -> None:
    assert in_place_of in BENCH
    parse_scene(BENCH.replace(in_place_of, stated, 1), "x.toml")
