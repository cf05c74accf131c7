"""`place`, `build` and `explain` refuse the same scenes, with the same line, but `explain` places no sensors."""

from pathlib import Path

import pytest

from example_scenes import PAPER
from in_process import Command

CASES = {
    "unknown key": ("[beam]", "[beam]\ncolour = 3", "unknown key beam.colour"),
    "length": ("length_mm = 400", "length_mm = -400", "beam.length_mm"),
    "supports": ("[beam]", "[beam]\nsupports = [{at_mm = 100}]", "one simple support lets the beam rotate"),
    "foundation": ("[beam]", "[beam]\nfoundation_n_mm2 = 1e30", "too stiff beside this beam"),
    "large angles": ("force_n = 10.0", "force_n = 300", "small-angle theory"),
    "range": ("count = 2", "count = 2\nrange_mm = [1, 2]", "leaves sensors.range_mm"),
    "no noise": ("noise_percent_of_max = 2", "noise_mm = 0", "a noise of 0"),
    "drift": ("count = 2", "count = 2\nzero_drift_mm = 1e9", "zero_drift_mm"),
    "latency": (
        "noise_percent_of_max = 2\n",
        "noise_percent_of_max = 2\n[requirements]\nlatency_ms = 1\n",
        "shorter than one reading",
    ),
    "distance": ("count = 2", "count = 2\nmin_distance_mm = 399", "no layout of 2 sensors keeps the rules"),
    "fixed": ("count = 2", "count = 2\nfixed_mm = [100, 200, 300]", "more than the 2 to be placed"),
    "open count": ("count = 2", 'count = "auto"', "give requirements.position_error_mm, or --sensors N"),
    "out of reach": (
        "count = 2\nnoise_percent_of_max = 2\n",
        "count = [2, 3]\nnoise_percent_of_max = 2\n[requirements]\nposition_error_mm = 0.01\n",
        "not even 3 sensors reach requirements.position_error_mm",
    ),
    "no room for more": (
        "count = 2\nnoise_percent_of_max = 2\n",
        "count = [2, 5]\nnoise_percent_of_max = 2\nmin_distance_mm = 250\n[requirements]\nposition_error_mm = 0.01\n",
        "not even 2 sensors reach requirements.position_error_mm = 0.01: the accuracy limit is",
    ),
    "nothing is seen": ("noise_percent_of_max = 2", "noise_percent_of_max = 90", "no contact of the scene is seen"),
    "housings": ("count = 2", "count = 2\nfixed_mm = [200, 207]", "fixed_mm has 200 and 207 mm, 7 mm apart, less than"),
    "neighbours": (
        "count = 2",
        "count = 2\nfixed_mm = [200, 209]\nmounting_tolerance_mm = 10",
        "no layout of 2 sensors keeps the rules",
    ),
}

PLACED = ("open count", "out of reach", "no room for more", "nothing is seen")
"""Found only by placing sensors, which `explain` does not."""


@pytest.mark.parametrize("name", CASES)
def test_every_command_refuses_a_scene_with_the_same_line(
    design_sensors_here: Command, tmp_path: Path, name: str
) -> None:
    old, new, said = CASES[name]
    scene, model = tmp_path / "scene.toml", tmp_path / "model.onnx"
    assert old in PAPER
    scene.write_text(PAPER.replace(old, new, 1))
    lines = set()
    commands = [("place", scene), ("build", scene, "-o", model)]
    for command in commands if name in PLACED else [*commands, ("explain", scene)]:
        done = design_sensors_here(*command)
        assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1), done.stderr
        lines.add(done.stderr)
    assert len(lines) == 1
    assert said in lines.pop()
    assert not model.exists()


@pytest.mark.parametrize("name", PLACED)
def test_effects_are_explained_before_the_sensors_can_be_placed(
    design_sensors_here: Command, tmp_path: Path, name: str
) -> None:
    old, new, _ = CASES[name]
    scene = tmp_path / "scene.toml"
    scene.write_text(PAPER.replace(old, new, 1))

    done = design_sensors_here("explain", scene)

    assert done.returncode == 0, done.stderr
    assert "contact width" in done.stdout
