"""A position error that a scene requires and its model does not reach: `build` and `evaluate` say so."""

import re
from pathlib import Path

import pytest

from example_scenes import PAPER
from in_process import Command

COARSE = PAPER.replace("count = 2", "count = 2\ngrid_mm = 57")
MISSED = r"note:    the mean error is [\d.]+ mm, more than requirements.position_error_mm = 0.5; use more sensors"


@pytest.mark.usefixtures("short_work")
def test_a_requirement_that_is_missed_is_remarked(design_sensors_here: Command, tmp_path: Path) -> None:
    scene, model = tmp_path / "paper.toml", tmp_path / "paper.onnx"
    for wanted_mm, is_missed in ((0.5, True), (50, False)):
        scene.write_text(f"{COARSE}\n[requirements]\nposition_error_mm = {wanted_mm}\n")
        for arguments in (("build", scene, "-o", model), ("evaluate", model, "--draws", 100)):
            done = design_sensors_here(*arguments, "--json")
            assert done.returncode == 0, done.stderr
            assert bool(re.search(MISSED, done.stderr)) == is_missed


@pytest.mark.usefixtures("short_work")
def test_place_says_that_the_best_possible_error_misses_it_too(design_sensors_here: Command, tmp_path: Path) -> None:
    scene = tmp_path / "paper.toml"
    for wanted_mm, is_missed in ((0.5, True), (50, False)):
        scene.write_text(f"{COARSE}\n[requirements]\nposition_error_mm = {wanted_mm}\n")
        done = design_sensors_here("place", scene)
        said = r"note:    the accuracy limit is ([\d.]+) mm, more than requirements.position_error_mm = 0.5; use more"
        found = re.search(said, done.stderr)
        assert (done.returncode, bool(found)) == (0, is_missed), done.stderr
        if found:
            assert f"of the length, {found[1]} mm, at" in done.stdout
