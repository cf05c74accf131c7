"""Scenes that no surface can be built of: every command refuses them before any work, for the same reason."""

from pathlib import Path

import pytest

from example_scenes import PAPER
from in_process import Command

WORK = {"place": (), "explain": (), "build": ("-o", "model.onnx"), "trade": ("-o", "out", "--draws", "100")}
NINE = ", ".join(str(40 * k) for k in range(1, 10))
REFUSED = {
    "slopes by": ("thickness_mm = 3", "thickness_mm = 1"),
    "leaves sensors.range_mm": ("count = 2", "count = 2\nrange_mm = [1, 2]"),
    "a noise of 0": ("noise_percent_of_max = 2", "noise_mm = 0"),
    "hides the largest deflection": ("noise_percent_of_max = 2", "noise_mm = 1e9"),
    "too little for the float32": ("noise_percent_of_max = 2", "noise_mm = 1e-12"),
    "is shorter than one reading": ("[sensors]", "[requirements]\nlatency_ms = 1\n\n[sensors]"),
    "3 sensors, more than the 2 to be placed": ("count = 2", "count = 2\nfixed_mm = [50, 200, 300]"),
    "9 sensors, more than the 8 to be placed": ("count = 2", f'count = "auto"\nfixed_mm = [{NINE}]'),
    "no layout of 2 sensors keeps the rules": ("count = 2", "count = 2\nmin_distance_mm = 399"),
    "fewer than two positions": ("count = 2", "count = 2\nkeep_out_mm = [[0, 400]]"),
}


@pytest.mark.parametrize("said", REFUSED)
def test_all_commands_refuse_the_same_scenes_for_the_same_reasons(
    design_sensors_here: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, said: str
) -> None:
    monkeypatch.chdir(tmp_path)
    old, new = REFUSED[said]
    Path("scene.toml").write_text(PAPER.replace(old, new))
    told = set()
    for name, options in WORK.items():
        done = design_sensors_here(name, "scene.toml", *options)
        assert (name, done.returncode, done.stdout) == (name, 2, "")
        told.add(done.stderr)
    (line,) = told
    assert line.count("\n") == 1
    assert said in line
    assert not list(tmp_path.rglob("*.json"))
    assert not list(tmp_path.rglob("*.onnx"))


def test_the_number_of_sensors_of_an_option_counts(
    design_sensors_here: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("scene.toml").write_text(PAPER.replace("count = 2", "count = 2\nfixed_mm = [50, 200, 300]"))
    done = design_sensors_here("place", "scene.toml", "--sensors", 4, "--json")
    assert (done.returncode, done.stderr) == (0, "")
    for name, options in (("place", ()), ("build", ("-o", "model.onnx"))):
        done = design_sensors_here(name, "scene.toml", "--sensors", 1, *options)
        assert (done.returncode, done.stderr.count("\n")) == (2, 1)
        assert "3 sensors, more than the 1 to be placed" in done.stderr
