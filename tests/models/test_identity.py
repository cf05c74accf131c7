"""The identity of a beam with its layout: what changes it, and what does not."""

import pytest

from beamtouch_models.design.scene import identity_of, parse_scene
from support.surfaces.example_scenes import PAPER

LAYOUT = {"s1": 100.0, "s2": 200.0, "s3": 300.0}


def identity(*changes: tuple[str, str], layout: dict[str, float] = LAYOUT) -> str:
    text = PAPER
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    return identity_of(parse_scene(text, "a scene"), layout)


@pytest.mark.parametrize(
    "change",
    [
        ("noise_percent_of_max = 2", "noise_mm = 0.008\nzero_drift_mm = 0.01\ngain_error_percent = 1"),
        ("count = 2", "count = 3\nrange_mm = [1, 6]\nstandoff_mm = 4"),
        ("force_n = 10.0", "force_n = [1.0, 10.0]"),
        ("[sensors]", '[requirements]\ndescriptors = ["position", "force"]\n[sensors]'),
        ("youngs_modulus_gpa = 210", 'material = "steel"'),
        ("thickness_mm = 3", "thickness_mm = 3\ndensity_kg_m3 = 7850\ndamping_ratio = 0.02"),
        ("length_mm = 400", 'length_mm = 400.0\nsupports = [{at_mm = 400}, {at_mm = 0, kind = "simple"}]'),
        ("thickness_mm = 3", "thickness_mm = 3.0000001"),
    ],
)
def test_what_moves_no_sensor_differently_keeps_it(change: tuple[str, str]) -> None:
    assert identity(change) == identity()


@pytest.mark.parametrize(
    "change",
    [
        ("length_mm = 400", "length_mm = 401"),
        ("thickness_mm = 3", "thickness_mm = 3.1"),
        ("youngs_modulus_gpa = 210", "youngs_modulus_gpa = 70"),
        ("youngs_modulus_gpa = 210", "youngs_modulus_gpa = 210\nshear_modulus_gpa = 80"),
        ("length_mm = 400", 'length_mm = 400\nsupports = "propped"'),
        ("length_mm = 400", "length_mm = 400\nsupports = [{at_mm = 0}, {at_mm = 399}]"),
        ("length_mm = 400", "length_mm = 400\nsupports = [{at_mm = 0, fixity = 0.1}, {at_mm = 400}]"),
        ("thickness_mm = 3", "thickness_mm = 3\nsegments = [{to_mm = 200}, {to_mm = 400, thickness_mm = 4}]"),
        ("thickness_mm = 3", "thickness_mm = 3\nfoundation_n_mm2 = 0.05"),
    ],
)
def test_another_beam_has_another_one(change: tuple[str, str]) -> None:
    assert identity(change) != identity()


def test_sensors_elsewhere_or_under_other_names_have_another_one_and_their_order_has_no_part() -> None:
    assert identity(layout=dict(reversed(LAYOUT.items()))) == identity()
    others = ({**LAYOUT, "s2": 200.1}, {"s1": 200.0, "s2": 100.0, "s3": 300.0}, {"s1": 100.0, "s2": 200.0})
    assert len({identity(), *(identity(layout=layout) for layout in others)}) == 4


def test_it_is_the_same_in_every_version() -> None:
    assert identity() == "196e477cae24"
