"""Scenes are read from TOML; a bad one is refused in one line. `docs/mistakes.md` has more of them, word for word."""

import pytest

from beamtouch_common.errors import InputError
from beamtouch_models.design.scene import parse_scene
from support.surfaces.example_scenes import PAPER

COUNT, NOISE, MODULUS, WIDTH = "count = 2", "noise_percent_of_max = 2", "youngs_modulus_gpa = 210", "width_mm = 25"
CONTACTS = "position_mm = [1, 399]"
METRES = "next to the left end of the beam; if it is in metres, write [100, 300]"
RIGID = "flexural_rigidity_n_mm2 = 1e7"


def test_rigidity_of_a_rectangular_section() -> None:
    # 210 GPa, 25 x 3 mm: I = 56.25 mm^4 (b h^3 / 12), E I = 1.18125e7 N mm^2.
    assert parse_scene(PAPER, "x").beam.rigidity_n_mm2 == pytest.approx(1.18125e7, rel=1e-15)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (WIDTH, f"{WIDTH}\nwidht_mm = 3", "unknown key beam.widht_mm"),
        ("length_mm = 400", "length_mm = nan", "beam.length_mm: must be a finite number"),
        # Supports, sections and what carries the beam.
        ("[beam]", "[beam]\nsupports = []", "nothing carries the beam"),
        ("[beam]", "[beam]\nsupports = [{at_mm = 0}, {at_mm = 401}]", "one lies off the beam, 0..400 mm"),
        ("[beam]", "[beam]\nsupports = [{at_mm = 9}, {at_mm = 9, kind = 'fixed'}]", "two stand at the same place"),
        ("[beam]", "[beam]\nsupports = [{at_mm = 0, kind = 'fixed', fixity = 0.1}]", "no fixity"),
        ("[beam]", "[beam]\nsupports = [{at_mm = 0, fixity = 1.0}]", "fixity: must be less than 1"),
        ("[beam]", "[beam]\nsupports = [{at_mm = 0, fixity = -0.1}]", "fixity: must be at least 0"),
        ("[beam]", "[beam]\nsupports = [{at_mm = 0, fixity = 0.0}]", "lets the beam rotate"),
        ("[beam]", "[beam]\nfoundation_n_mm2 = 0", "foundation_n_mm2: must be more than 0"),
        (WIDTH, f"{WIDTH}\nsegments = [{{to_mm = 300}}]", "segments end at 300 mm, the beam at 400 mm"),
        (WIDTH, f"{WIDTH}\nsegments = [{{to_mm = 300}}, {{to_mm = 200}}]", "must ascend"),
        (WIDTH, f"{WIDTH}\nsegments = [{{to_mm = 400, width_mm = 20, {RIGID}}}]", "flexural_rigidity_n_mm2, not both"),
        (f"{MODULUS}\n{WIDTH}\n", f"{RIGID}\nshear_modulus_gpa = 80\n", "needs width_mm and thickness_mm"),
        # Materials.
        (MODULUS, "youngs_modulus_gpa = 1e300", "is more than any material has; state it in GPa"),
        (MODULUS, f"{MODULUS}\nshear_modulus_gpa = 210", "shear_modulus_gpa = 210 must be less than Young's modulus"),
        (MODULUS, f"{MODULUS}\nexpansion_um_per_m_k = 12000", "is more than any material has; state it in um/(m K)"),
        (MODULUS, f"{MODULUS}\ndensity_kg_m3 = 7850000", "state it in kg/m3"),
        # Contacts.
        (CONTACTS, "position_mm = [399, 1]", "the first must be less than the second"),
        ("force_n = 10.0", "force_n = 0", "contact.force_n"),
        ("position_mm", "width_mm = -1\nposition_mm", "contact.width_mm"),
        # Sensors.
        (COUNT, "count = [5, 2]", "sensors.count = [5, 2]: the first must not exceed the second"),
        (NOISE, "noise_mm = -1", "sensors.noise_mm"),
        (COUNT, f"{COUNT}\nstandoff_mm = 5\nrange_mm = [1, 4]", "standoff_mm = 5 lies outside range_mm"),
        (COUNT, f"{COUNT}\nkeep_out_mm = [[30, 20]]", "the start of a stretch must be less than its end"),
        (COUNT, f"{COUNT}\nkeep_out_mm = [[9, 12], [0.1, 0.3]]", f"keep_out_mm[1] = [0.1, 0.3] is {METRES}"),
        (COUNT, f"{COUNT}\nfixed_mm = [0.1, 0.3]", METRES),
        (COUNT, "count = 4\nmounting_tolerance_mm = 100", "4 sensors on 400 mm are 100 mm apart"),
        # Requirements.
        (
            "[sensors]",
            "[requirements]\nfalse_contacts_per_day = 86401\n[sensors]",
            "false_contacts_per_day = 86401: at sensors.rate_hz = 100 at most 86400 a day, one sample in 100",
        ),
    ],
)
def test_a_bad_scene_is_refused_in_one_line_that_names_the_key(old: str, new: str, said: str) -> None:
    assert old in PAPER
    with pytest.raises(InputError) as caught:
        parse_scene(PAPER.replace(old, new, 1), "press.toml")
    message = str(caught.value)
    assert message.startswith("press.toml: ")
    assert said in message
    assert "\n" not in message


@pytest.mark.promise(
    "docs/explanation/what-it-can-know.md",
    "A scene that states one number means it within `force_tolerance_percent`, 1 unless stated",
)
@pytest.mark.parametrize(
    ("stated", "force_n"),
    [
        ("force_n = 10.0", (9.9, 10.1)),
        ("force_n = 10.0\nforce_tolerance_percent = 0", (10.0, 10.0)),
        ("force_n = 10.0\nforce_tolerance_percent = 5", (9.5, 10.5)),
        ("force_n = [9.0, 12.0]", (9.0, 12.0)),
    ],
)
def test_one_force_is_known_within_a_tolerance(stated: str, force_n: tuple[float, float]) -> None:
    scene = parse_scene(PAPER.replace("force_n = 10.0", stated), "x.toml")
    assert scene.contact.force_range_n == pytest.approx(force_n, rel=1e-12)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (COUNT, f"{COUNT}\nfixed_mm = [86]\nkeep_out_mm = [[90, 110]]"),
        (COUNT, f"{COUNT}\nkeep_out_mm = [[-9, 30], [390, 480]]"),
        (CONTACTS, "position_mm = [0, 0.5]"),
        (CONTACTS, f"{CONTACTS}\nwidth_mm = 399"),
        ("[beam]", '[beam]\nsupports = [{ at_mm = 0, kind = "fixed" }]'),
        (MODULUS, f"{MODULUS}\nshear_modulus_gpa = 80"),
    ],
)
def test_a_scene_that_can_be_meant_is_taken(old: str, new: str) -> None:
    assert old in PAPER
    parse_scene(PAPER.replace(old, new, 1), "x.toml")
