"""`design-sensors place`, run as a user runs it."""

import json
import re
from pathlib import Path

import pytest

from support.programs.in_process import Command
from support.surfaces.example_scenes import PAPER, SCENES

KEYS = {
    "positions_mm", "log_eigenvalue_product", "accuracy_limit_percent", "standard_error", "gap",
    "evaluations", "criterion", "failed_percent", "reasons", "compared", "limit_without_percent",
    "limit_without_standard_error", "search", "seed", "components", "recommended_sensors",
}  # fmt: skip
PRODUCT = ("--criterion", "eigenvalue-product")


def scene_in(folder: Path, *changes: tuple[str, str]) -> Path:
    """Write the paper's scene with changes."""
    text = PAPER
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path = folder / "scene.toml"
    path.write_text(text)
    return path


@pytest.mark.parametrize("option", [PRODUCT, ("--components", 5)])
def test_the_layout_of_five_sensors_states_its_gap(design_sensors_roughly: Command, option: tuple[object, ...]) -> None:
    done = design_sensors_roughly("place", SCENES / "paper.toml", "--sensors", 5, *option, "--json")
    assert (done.returncode, done.stderr) == (0, "")
    found = json.loads(done.stdout)
    assert set(found) == KEYS
    assert (found["criterion"], found["positions_mm"]) == ("eigenvalue-product", [56, 128, 200, 272, 344])
    assert found["log_eigenvalue_product"] == pytest.approx(-74.9065, abs=5e-5)
    assert 0 <= found["gap"] < 1e-3
    assert abs(found["accuracy_limit_percent"] - 2.77) < 5 * found["standard_error"]


def test_by_default_the_scenes_number_of_sensors_has_the_least_position_error(design_sensors_here: Command) -> None:
    found = json.loads(design_sensors_here("place", SCENES / "paper.toml", "--json").stdout)
    assert (found["criterion"], found["search"], found["seed"]) == ("position-error", "exchange", 0)
    assert (found["components"], len(found["positions_mm"]), found["failed_percent"], found["gap"]) == (2, 2, 10, None)
    # One sensor does not tell the two halves of the beam apart.
    assert min(found["limit_without_percent"]) > 2 * found["accuracy_limit_percent"]
    # From independent code: 3.78 % near 107 and 293 mm, 4.12 % at the optimum of the product.
    assert found["positions_mm"] == pytest.approx([107, 293], abs=14)
    assert found["accuracy_limit_percent"] == pytest.approx(3.78, abs=0.06 + 3 * found["standard_error"])
    assert 3 * found["standard_error"] < 0.2


@pytest.mark.promise(
    "docs/how-to/design.md",
    "`--failed-percent 100` makes the error small even when the worst single sensor has failed.",
)
def test_a_spare_is_stated_with_the_error_without_each_sensor(design_sensors_roughly: Command, tmp_path: Path) -> None:
    path = scene_in(tmp_path, ("count = 2", "count = 3\ngrid_mm = 80"), ("10.0", "[2.0, 20.0]"))
    found = json.loads(design_sensors_roughly("place", path, "--failed-percent", 100, "--json").stdout)
    assert found["failed_percent"] == 100
    assert len(found["limit_without_percent"]) == 3
    assert min(found["limit_without_percent"]) > found["accuracy_limit_percent"]
    table = design_sensors_roughly("place", path, "--failed-percent", 100).stdout
    worst_mm = 4 * max(found["limit_without_percent"])
    failed = re.findall(r"at \d+ mm: (\d+) \+-\s", table)
    assert max(map(float, failed)) == pytest.approx(worst_mm, abs=0.5)
    assert "with the worst sensor failed 100 % of the time" in table
    assert not re.search(r"^(product|bound) ", table, re.MULTILINE)  # they belong to the other criterion


@pytest.mark.promise("docs/how-to/design.md", "`--spare 1` is short for it, and `--spare 0` for `--failed-percent 0`.")
def test_a_number_of_spare_sensors_is_short_for_a_share_of_the_time(
    design_sensors_roughly: Command, tmp_path: Path
) -> None:
    path = scene_in(tmp_path, ("count = 2", "count = 2\ngrid_mm = 80"), ("10.0", "[2.0, 20.0]"))
    for spare, percent in ((0, 0.0), (1, 100.0)):
        found = json.loads(design_sensors_roughly("place", path, "--spare", spare, "--json").stdout)
        assert found["failed_percent"] == percent
    for wrong, words in (
        (("--spare", 2), "'2' is neither 0 nor 1"),
        (("--spare", 1, "--failed-percent", 5), "--failed-percent: not allowed with argument --spare"),
    ):
        refused = design_sensors_roughly("place", path, *wrong)
        assert refused.returncode == 2
        assert words in refused.stderr


def test_the_table_shows_the_layout_of_the_papers_figure_5(design_sensors_roughly: Command, tmp_path: Path) -> None:
    path = scene_in(tmp_path, ("[sensors]", "[sensors]\nsize_mm = 0"))  # the paper's sensors have no size
    done = design_sensors_roughly("place", path, "--sensors", 8, "--components", 4, "--search", "paper")
    assert done.returncode == 0, done.stderr
    assert "68, 69, 156, 157, 243, 244, 331, 332 mm" in done.stdout
    assert "ln -52.6760: the logarithm of the product of the 4 leading eigenvalues" in " ".join(done.stdout.split())
    assert "no layout on the grid" in done.stdout
    assert max(map(len, done.stdout.splitlines())) <= 100


@pytest.mark.promise("docs/how-to/design.md", "take the smallest number that reaches it")
@pytest.mark.parametrize(
    ("sensors", "error_mm", "options", "count", "kept"),
    [
        ("count = [2, 5]\ngrid_mm = 57", 30, (), 2, set()),
        ("count = [2, 5]\ngrid_mm = 57", 16, (), 3, set()),
        ('count = "auto"\nfixed_mm = [50, 200, 333]\ngrid_mm = 57', 20, (), 3, {50, 200, 333}),
        ("count = [2, 5]\ngrid_mm = 57", 30, ("--components", 3), 3, set()),
    ],
)
def test_an_open_number_is_the_fewest_that_meets_the_requirement_with_room_for_fixed_sensors_and_components(
    design_sensors_roughly: Command,
    tmp_path: Path,
    sensors: str,
    error_mm: float,
    options: tuple[object, ...],
    count: int,
    kept: set[float],
) -> None:
    required = f"\n[requirements]\nposition_error_mm = {error_mm}\n[sensors]"
    path = scene_in(tmp_path, ("count = 2", sensors), ("\n[sensors]", required))
    done = design_sensors_roughly("place", path, *options, "--json")
    assert (done.returncode, done.stderr) == (0, "")
    positions = json.loads(done.stdout)["positions_mm"]
    assert len(positions) == count
    assert kept <= set(positions)


def test_place_states_the_noise_that_effects_are_priced_in(design_sensors_roughly: Command) -> None:
    # The ADC of the conveyor is left out of its model, and its steps of 0.9 um stay in its noise.
    placed = design_sensors_roughly("place", SCENES / "conveyor.toml", "--sensors", 2, *PRODUCT)
    assert "at 1.35 um noise per sample" in " ".join(placed.stdout.split())
    assert "a sample's noise, 1.35 um" in design_sensors_roughly("explain", SCENES / "conveyor.toml").stdout
