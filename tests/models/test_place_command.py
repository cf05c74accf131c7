"""`design-sensors place`, run as a user runs it."""

import json
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import pytest

from beamtouch_models.scene import load_scene
from beamtouch_models.surface import Surface
from example_scenes import PAPER, SCENES
from in_process import Command
from stated_problems import fewest_mm

KEYS = {
    "positions_mm", "log_eigenvalue_product", "accuracy_limit_percent", "standard_error", "gap",
    "evaluations", "wall_s", "criterion", "spare", "limit_without_percent",
    "limit_without_standard_error", "search", "seed", "components", "recommended_sensors",
}  # fmt: skip


def place(*arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "beamtouch_models.cli", "place", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=150)


def test_the_layout_of_five_sensors_states_its_gap() -> None:
    done = place(SCENES / "paper.toml", "--sensors", 5, "--criterion", "eigenvalue-product", "--json")
    assert (done.returncode, done.stderr) == (0, "")
    found = json.loads(done.stdout)
    assert set(found) == KEYS
    assert found["positions_mm"] == [56, 128, 200, 272, 344]
    assert found["log_eigenvalue_product"] == pytest.approx(-74.9065, abs=5e-5)
    assert 0 <= found["gap"] < 1e-3
    assert found["accuracy_limit_percent"] == pytest.approx(2.77, abs=0.1)
    assert 0 < found["standard_error"] < 0.05
    assert found["wall_s"] > 0


@pytest.mark.usefixtures("short_limit")
def test_the_defaults_are_the_scenes_number_of_sensors_the_position_error_and_the_exact_search(
    design_sensors_here: Command,
) -> None:
    found = json.loads(design_sensors_here("place", SCENES / "paper.toml", "--json").stdout)
    assert (found["criterion"], found["search"], found["seed"]) == ("position-error", "exact", 0)
    assert (len(found["positions_mm"]), found["spare"]) == (2, 0)


def test_the_position_error_is_a_criterion_too(design_sensors_here: Command) -> None:
    asked = ("place", SCENES / "paper.toml", "--criterion", "position-error", "--json")
    found = json.loads(design_sensors_here(*asked).stdout)
    assert found["criterion"] == "position-error"
    assert found["spare"] == 0
    # One sensor does not tell the two halves of the beam apart.
    assert min(found["limit_without_percent"]) > 2 * found["accuracy_limit_percent"]
    assert found["components"] == len(found["positions_mm"]) == 2
    # From independent code: 3.78 % at the least error, 4.12 % at the largest eigenvalue product.
    assert found["accuracy_limit_percent"] == pytest.approx(3.78, abs=0.08)


@pytest.mark.usefixtures("short_limit")
@pytest.mark.parametrize("option", [("--criterion", "eigenvalue-product"), ("--components", 2)])
def test_components_and_gaps_are_those_of_the_eigenvalue_product(
    design_sensors_here: Command, option: tuple[object, ...]
) -> None:
    found = json.loads(design_sensors_here("place", SCENES / "paper.toml", *option, "--json").stdout)
    assert (found["criterion"], found["positions_mm"]) == ("eigenvalue-product", [122, 278])
    assert 0 <= found["gap"] < 1e-3
    refused = design_sensors_here("place", SCENES / "paper.toml", *option, "--spare", 1)
    assert (refused.returncode, refused.stdout, refused.stderr.count("\n")) == (2, "", 1)
    assert "spare = 1: give 0, or 1, which places by position error" in refused.stderr


@pytest.mark.usefixtures("short_limit")
def test_a_spare_is_stated_with_the_error_without_each_sensor(design_sensors_here: Command, tmp_path: Path) -> None:
    path = tmp_path / "coarse.toml"
    path.write_text(PAPER.replace("count = 2", "count = 3\ngrid_mm = 80").replace("10.0", "[2.0, 20.0]"))
    found = json.loads(design_sensors_here("place", path, "--spare", 1, "--json").stdout)
    assert found["spare"] == 1
    assert len(found["limit_without_percent"]) == 3
    assert min(found["limit_without_percent"]) > found["accuracy_limit_percent"]
    lines = dict(
        line.split(maxsplit=1) for line in design_sensors_here("place", path, "--spare", 1).stdout.splitlines()
    )
    worst = max(found["limit_without_percent"])
    assert f"{worst:.3g} % +-" in lines["failed"]


@pytest.mark.usefixtures("short_limit")
def test_the_table_shows_the_layout_of_the_papers_figure_5(design_sensors_here: Command, tmp_path: Path) -> None:
    points = tmp_path / "points.toml"  # the paper's sensors have no size
    points.write_text((SCENES / "paper.toml").read_text().replace("[sensors]", "[sensors]\nsize_mm = 0"))
    done = design_sensors_here("place", points, "--sensors", 8, "--components", 4, "--search", "paper")
    assert done.returncode == 0, done.stderr
    assert "68, 69, 156, 157, 243, 244, 331, 332 mm" in done.stdout
    assert "ln -52.6760 (4 leading eigenvalues" in done.stdout
    assert "no layout on the grid" in done.stdout


@pytest.mark.usefixtures("short_limit")
def test_position_error_has_no_gap(design_sensors_here: Command, tmp_path: Path) -> None:
    path = tmp_path / "coarse.toml"
    path.write_text(PAPER.replace("count = 2", "count = 3\ngrid_mm = 40"))
    asked = ("place", path, "--sensors", 2, "--criterion", "position-error", "--json")
    found = json.loads(design_sensors_here(*asked).stdout)
    assert len(found["positions_mm"]) == 2
    assert (found["criterion"], found["gap"]) == ("position-error", None)


@pytest.mark.usefixtures("short_limit")
def test_the_paper_search_by_position_error_shows_a_table(design_sensors_here: Command, tmp_path: Path) -> None:
    path = tmp_path / "coarse.toml"
    path.write_text(PAPER.replace("count = 2", "count = 2\ngrid_mm = 20"))
    done = design_sensors_here("place", path, "--criterion", "position-error", "--search", "paper", "--seed", 1)
    assert done.returncode == 0, done.stderr
    lines = dict(line.split(maxsplit=1) for line in done.stdout.splitlines())
    assert lines["sensors"] == "100, 300 mm from the left end"
    assert lines["bound"] == "none: this criterion has no bound"
    assert lines["search"] == "paper, by position-error, seed 1"


@pytest.mark.usefixtures("short_limit")
def test_an_open_number_is_that_of_a_build_and_the_option_overrides_it(
    design_sensors_here: Command, tmp_path: Path
) -> None:
    path = tmp_path / "open.toml"
    text = PAPER.replace("count = 2", "count = [2, 5]\ngrid_mm = 19")
    path.write_text(text + "\n[requirements]\nposition_error_mm = 15\n")
    scene, _ = load_scene(path)
    built = fewest_mm(scene, Surface.of(scene).noise.sample_mm)
    assert len(built) == 3
    found = json.loads(design_sensors_here("place", path, "--json").stdout)
    assert found["positions_mm"] == built.tolist()
    found = json.loads(design_sensors_here("place", path, "--sensors", 2, "--json").stdout)
    assert len(found["positions_mm"]) == 2


@pytest.mark.usefixtures("short_limit")
def test_an_open_number_makes_room_for_the_fixed_sensors(design_sensors_here: Command, tmp_path: Path) -> None:
    path = tmp_path / "fixed.toml"
    text = PAPER.replace("count = 2", 'count = "auto"\nfixed_mm = [50, 200, 333]')
    path.write_text(text + "\n[requirements]\nposition_error_mm = 20\n")
    done = design_sensors_here("place", path, "--json")
    assert (done.returncode, done.stderr) == (0, "")
    assert {50, 200, 333} <= set(json.loads(done.stdout)["positions_mm"])


def test_an_open_number_begins_with_the_components_that_are_asked_for(
    design_sensors_here: Command, tmp_path: Path
) -> None:
    path = tmp_path / "open.toml"
    path.write_text(PAPER.replace("count = 2", "count = [2, 5]") + "\n[requirements]\nposition_error_mm = 30\n")
    done = design_sensors_here("place", path, "--components", 3, "--json")
    assert (done.returncode, done.stderr) == (0, "")
    assert len(json.loads(done.stdout)["positions_mm"]) == 3


@pytest.mark.usefixtures("short_limit")
def test_place_states_the_noise_that_effects_are_priced_in(design_sensors_here: Command) -> None:
    # The ADC of the conveyor is left out of its model, and its steps of 0.9 um stay in its noise.
    placed = design_sensors_here("place", SCENES / "conveyor.toml", "--sensors", 2)
    assert "at 0.00135 mm noise per sample" in placed.stdout
    assert "a sample's noise, 0.00135 mm" in design_sensors_here("explain", SCENES / "conveyor.toml").stdout


@pytest.mark.parametrize(
    ("old", "new", "arguments", "said"),
    [
        ("count = 2", 'count = "auto"', (), "give requirements.position_error_mm, or --sensors N"),
        ("count = 2", "count = 2\nmin_distance_mm = 399", (), "no layout of 2 sensors keeps the rules"),
        ("count = 2", "count = 2", ("--components", 3), "2 sensors have 2 components, not 3"),
        ("noise_percent_of_max = 2", "noise_mm = 0", ("--criterion", "position-error"), "state the noise"),
        (
            "[1, 399]",
            "[200, 200.001]",
            ("--sensors", 3, "--criterion", "eigenvalue-product"),
            "widen contact.position_mm",
        ),
    ],
)
def test_a_scene_that_cannot_be_placed_gives_one_line_and_exit_2(
    design_sensors_here: Command, tmp_path: Path, old: str, new: str, arguments: tuple[object, ...], said: str
) -> None:
    scene = tmp_path / "scene.toml"
    scene.write_text(PAPER.replace(old, new))
    done = design_sensors_here("place", scene, *arguments)
    assert done.returncode == 2
    assert said in done.stderr
    assert done.stderr.count("\n") == 1
    assert done.stdout == ""


CLAMPED = """
[beam]
length_mm = 300
material = "steel"
width_mm = 20
thickness_mm = 3
supports = [{ at_mm = 300, kind = "fixed" }]

[contact]
force_n = [0.5, 4]
position_mm = [5, 280]

[sensors]
count = 3
noise_mm = 0.005
range_mm = [1, 20]
"""


@pytest.mark.parametrize("criterion", ["position-error", "eigenvalue-product"])
def test_sensors_that_are_all_fixed_stay_where_they_are(
    design_sensors_here: Command, tmp_path: Path, criterion: str
) -> None:
    scene = tmp_path / "scene.toml"
    scene.write_text(f"{CLAMPED}fixed_mm = [100, 180, 260]\n")
    done = design_sensors_here("place", scene, "--criterion", criterion, "--json")
    assert json.loads(done.stdout)["positions_mm"] == [100, 180, 260]


@pytest.mark.parametrize(
    ("rules", "said"),
    [
        ("fixed_mm = [4, 12]", None),
        ("fixed_mm = [3.9]", "fixed_mm has 3.9 mm, where a housing of size_mm = 8 reaches beyond the end of the beam"),
        ("fixed_mm = [297]", "fixed_mm has 297 mm, where a housing of size_mm = 8 reaches beyond the end of the beam"),
        ("fixed_mm = [0, 290]\nsize_mm = 0", None),
        ("fixed_mm = [300]\nsize_mm = 0", "a housing of size_mm = 0 stands on the support at 300 mm"),
        ("fixed_mm = [100, 107]", "fixed_mm has 100 and 107 mm, 7 mm apart, less than size_mm = 8; move one"),
        ("fixed_mm = [100, 107]\nsize_mm = 7", None),
        ("fixed_mm = [100, 107]\nsize_mm = 7\nmin_distance_mm = 9", "less than min_distance_mm = 9; move one"),
        ("fixed_mm = [100]\nkeep_out_mm = [[103, 120]]", "size_mm = 8 reaches into [103, 120] of keep_out_mm"),
        ("fixed_mm = [100]\nkeep_out_mm = [[104, 120]]", None),
        ("size_mm = 300", "sensors.size_mm = 300 must be less than beam.length_mm = 300"),
        ("size_mm = 110", "no layout of 3 sensors keeps the rules of sensors (size_mm, "),
    ],
)
def test_a_housing_keeps_off_ends_supports_keep_outs_and_other_housings(
    design_sensors_here: Command, tmp_path: Path, rules: str, said: str | None
) -> None:
    scene = tmp_path / "scene.toml"
    scene.write_text(f"{CLAMPED}{rules}\ngrid_mm = 4\n")
    done = design_sensors_here("place", scene, "--criterion", "eigenvalue-product")
    assert done.returncode == (0 if said is None else 2), done.stderr
    assert (said or "") in done.stderr
    assert done.stderr.count("\n") == (0 if said is None else 1)


@pytest.mark.parametrize(
    "arguments", [(), ("--spare", 1), ("--criterion", "eigenvalue-product"), ("--search", "paper")]
)
def test_layouts_of_every_search_leave_room_for_the_housings(
    design_sensors_here: Command, tmp_path: Path, arguments: tuple[object, ...]
) -> None:
    """On two spans with a keep-out; as points, each search puts two of the sensors side by side."""
    rules = "size_mm = 34\nkeep_out_mm = [[90, 116]]\nfixed_mm = [133]\ngrid_mm = 3\ncount = 4"
    supports = "supports = [{ at_mm = 0 }, { at_mm = 180 }, { at_mm = 400 }]"
    scene = tmp_path / "scene.toml"
    scene.write_text(PAPER.replace("count = 2", rules).replace("[beam]", f"[beam]\n{supports}"))
    done = design_sensors_here("place", scene, *arguments, "--json")
    assert done.returncode == 0, done.stderr
    places = json.loads(done.stdout)["positions_mm"]
    assert 133 in places
    taken = sorted([(-17, 0), (180, 180), (400, 417), (90, 116), *((at - 17, at + 17) for at in places)])
    assert all(end <= start for (_, end), (start, _) in pairwise(taken))
