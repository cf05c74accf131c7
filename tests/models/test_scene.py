"""Scenes are read from TOML; a bad one is refused in one line."""

from pathlib import Path

import pytest

from beamtouch_common.errors import InputError
from beamtouch_models.scene import load_scene, parse_scene
from example_scenes import PAPER, SCENES


@pytest.mark.parametrize("path", sorted(SCENES.glob("*.toml")), ids=lambda path: path.stem)
def test_every_shipped_scene_is_valid(path: Path) -> None:
    scene, text = load_scene(path)
    assert scene.beam.length_mm > 0
    assert text == path.read_text()


def test_rigidity_of_a_rectangular_section() -> None:
    # 210 GPa, 25 x 3 mm: I = 56.25 mm^4 (b h^3 / 12), E I = 1.18125e7 N mm^2.
    assert parse_scene(PAPER, "x").beam.rigidity_n_mm2 == pytest.approx(1.18125e7, rel=1e-15)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("width_mm = 25", "width_mm = 25\nwidht_mm = 3", "unknown key beam.widht_mm"),
        ("length_mm = 400", "length_mm = -400", "beam.length_mm: must be more than 0 (given: -400)"),
        ("length_mm = 400", "lenght_mm = 400", "unknown key beam.lenght_mm"),
        ("length_mm = 400", "length_mm = nan", "beam.length_mm"),
        ("length_mm = 400", "length_mm = inf", "beam.length_mm"),
        ("length_mm = 400", "", "beam.length_mm is missing; add it"),
        ("count = 2", "count = 2\nstandoff_mm = 5\nrange_mm = [1, 4]", "standoff_mm = 5 lies outside range_mm"),
        ("count = 2", "count = 2\nrange_mm = [4, 1]", "range_mm = [4.0, 1.0]: the first must be less than the second"),
        ("count = 2", "count = 2\nkeep_out_mm = [[30, 20]]", "the start of a stretch must be less than its end"),
        ("count = 2", "count = 0", "sensors.count"),
        ("count = 2", "count = [5, 2]", "first must not exceed the second"),
        ("noise_percent_of_max = 2", "", "give either noise_mm or noise_percent_of_max"),
        ("noise_percent_of_max = 2", "noise_percent_of_max = 2\nnoise_mm = 1", "give either noise_mm or"),
        ("noise_percent_of_max = 2", "noise_mm = -1", "sensors.noise_mm"),
        ("position_mm = [1, 399]", "position_mm = [1, 401]", "reaches beyond the beam, 0..400 mm"),
        ("position_mm = [1, 399]", "position_mm = [399, 1]", "the first must be less than the second"),
        ("force_n = 10.0", "force_n = [20.0, 2.0]", "the first must not exceed the second"),
        ("force_n = 10.0", "force_n = 0", "contact.force_n"),
        ("count = 2", "count = 4\nmounting_tolerance_mm = 100", "4 sensors on 400 mm are 100 mm apart"),
        ("count = 2", "count = 4\nmounting_tolerance_mm = 399", "mounting_tolerance_mm = 399: 4 sensors"),
        ("count = 2", "count = 2\nmounting_tolerance_mm = 1e9", "mounting_tolerance_mm = 1e+09: 2 sensors"),
        (
            "count = 2",
            "count = 2\nmounting_tolerance_mm = true",
            "mounting_tolerance_mm: must be a number (given: true)",
        ),
        ("count = 2", 'count = 2\nzero_drift_mm = "1"', 'zero_drift_mm: must be a number (given: "1")'),
        (
            "[sensors]",
            "[requirements]\nfalse_contacts_per_day = 86401\n[sensors]",
            "false_contacts_per_day = 86401: at sensors.rate_hz = 100 at most 86400 a day, one sample in 100",
        ),
        ("thickness_mm = 3", "", "give youngs_modulus_gpa or material, width_mm and thickness_mm, or flexural"),
        ("[beam]", "[beam]\nsupports = [{at_mm = 100}]", "one simple support lets the beam rotate: add a support"),
        ("[beam]", "[beam]\nsupports = [{at_mm = 100, kin = 'fixed'}]", "unknown key beam.supports[0].kin"),
        ("position_mm", "width_mm = -1\nposition_mm", "contact.width_mm"),
        ("count = 2", "count = 2\nfixed_mm = [200, 207]", "fixed_mm has 200 and 207 mm, 7 mm apart, less than"),
        ("[sensors]", "[requirements]\nlatency_ms = inf\n[sensors]", "latency_ms: must be a finite number"),
        ("width_mm = 25", "width_mm = 25\nsegments = [{to_mm = 300}]", "they must cover it exactly"),
        ("width_mm = 25", "width_mm = 25\nsegments = [{to_mm = 300}, {to_mm = 200}]", "must ascend"),
        (
            "width_mm = 25",
            "width_mm = 25\nsegments = [{to_mm = 400, width_mm = 20, flexural_rigidity_n_mm2 = 1e7}]",
            "give width_mm and thickness_mm or flexural_rigidity_n_mm2, not both",
        ),
        ("width_mm = 25", "width_mm = 25\nsupports = [{at_mm = 0}, {at_mm = 0}]", "two stand at the same place"),
        ("[beam]", "[beam", "not valid TOML"),
        ("[beam]", "x = " + "[" * 100_000, "not valid TOML"),
        ("[beam]", "x = " + "9" * 5000, "not valid TOML"),
    ],
)
def test_a_bad_scene_is_refused_in_one_line_that_names_the_key(old: str, new: str, said: str) -> None:
    with pytest.raises(InputError) as caught:
        parse_scene(PAPER.replace(old, new), "press.toml")
    message = str(caught.value)
    assert message.startswith("press.toml: ")
    assert said in message
    assert "\n" not in message


def test_a_file_that_is_not_there_or_not_text(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="No such file"):
        load_scene(tmp_path / "absent.toml")
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="not a text file in UTF-8"):
        load_scene(tmp_path / "binary.toml")
    with (tmp_path / "large.toml").open("wb") as file:
        file.truncate(2_000_000_000)
    with pytest.raises(InputError, match="larger than 1 MiB"):
        load_scene(tmp_path / "large.toml")
