"""A new build keeps the places of sensors that an earlier one placed, until it is told to move them."""

import json
import tomllib
from pathlib import Path

import pytest

from support.programs.in_process import Command
from support.surfaces.example_scenes import SCENES

ANEW = "--move-sensors places them anew"


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    path = tmp_path / "strip.toml"
    path.write_text((SCENES / "bench.toml").read_text())
    return path


def change(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))


@pytest.mark.soak
@pytest.mark.promise(
    "docs/how-to/design.md",
    (
        "A build that replaces a model, or a configuration of the daemon, keeps the places of the sensors in it, and "
        "says so."
    ),
    "a warning then says which sensor has moved, and where to.",
)
def test_sensors_stay_where_the_replaced_model_has_them_until_told_to_move(
    design_sensors_roughly: Command, scene: Path, tmp_path: Path
) -> None:
    model = tmp_path / "strip.onnx"

    def build(*options: object) -> tuple[list[float], str]:
        done = design_sensors_roughly("build", scene, "-o", model, "--json", *options)
        assert done.returncode == 0, done.stderr
        return json.loads(done.stdout)["positions_mm"], done.noted

    first, said = build()
    assert ANEW not in said
    change(scene, "position_mm = [", "position_mm = [60.0, 340.0] # [")
    kept, said = build()
    assert kept == first
    assert f"note: the sensors stay where {model} has them, as they may be mounted; {ANEW}" in said
    moved, said = build("--move-sensors")
    assert moved != first
    assert f"warning: sensors are not where {model} had them: " in said
    assert ANEW not in said
    more, said = build("--sensors", len(first) + 1)
    assert len(more) == len(first) + 1
    assert f"warning: sensors are not where {model} had them: " in said
    for option in (("--failed-percent", 100), ("--criterion", "eigenvalue-product")):
        _, said = build(*option)
        assert f"warning: sensors are not where {model} had them: " in said
        assert ANEW not in said
    _, said = build("--failed-percent", 0)
    assert ANEW not in said


@pytest.mark.soak
def test_places_that_the_scene_forbids_are_given_up_with_a_warning(
    design_sensors_roughly: Command, scene: Path, tmp_path: Path
) -> None:
    model = tmp_path / "strip.onnx"
    first = json.loads(design_sensors_roughly("build", scene, "-o", model, "--json").stdout)["positions_mm"]
    change(scene, "[sensors]", f"[sensors]\nkeep_out_mm = [[{first[0] - 1}, {first[0] + 1}]]")
    done = design_sensors_roughly("build", scene, "-o", model, "--json")
    assert json.loads(done.stdout)["positions_mm"][0] != first[0]
    assert f"warning: sensors are not where {model} had them: {first[0]:g} -> " in done.noted


@pytest.mark.promise(
    "docs/how-to/design.md",
    "write its place as `position_mm` of its channel in the daemon's configuration",
)
@pytest.mark.parametrize("encoding", [pytest.param("utf-8", marks=pytest.mark.soak), "utf-8-sig"])
def test_sensors_stay_where_the_daemon_configuration_has_them(
    design_sensors_roughly: Command, scene: Path, tmp_path: Path, encoding: str
) -> None:
    config = tmp_path / "daemon.toml"
    files = ("-o", tmp_path / "strip.onnx", "--daemon-config", config)
    built = design_sensors_roughly("build", scene, *files, "--json")
    first = json.loads(built.stdout)["positions_mm"]
    channels = tomllib.loads(config.read_text())["surfaces"]["strip"]["channels"]
    assert [channel["position_mm"] for channel in channels] == first
    change(config, f"position_mm = {first[0]!r}", f"position_mm = {first[0] + 3!r}")  # as it was drilled
    config.write_text(config.read_text(), encoding=encoding)  # some editors begin a file with a mark
    again = design_sensors_roughly("build", scene, *files, "--json", "--force")
    assert json.loads(again.stdout)["positions_mm"] == [first[0] + 3, *first[1:]]
    assert f"stay where {config} has them" in again.noted


@pytest.mark.soak
@pytest.mark.promise(
    "docs/how-to/design.md",
    "`inspect` and `beamtouch-daemon noise` print a line `fixed_mm` for the scene",
)
def test_inspect_prints_the_places_as_a_line_of_the_scene(
    design_sensors_roughly: Command, scene: Path, tmp_path: Path
) -> None:
    model = tmp_path / "strip.onnx"
    first = json.loads(design_sensors_roughly("build", scene, "-o", model, "--json").stdout)["positions_mm"]
    line = f"fixed_mm = {first}"
    assert line in design_sensors_roughly("inspect", model).stdout
    change(scene, "[sensors]", f"[sensors]\n{line}")
    change(scene, "position_mm = [", "position_mm = [60.0, 340.0] # [")
    fixed = design_sensors_roughly("build", scene, "-o", tmp_path / "fixed.onnx", "--json")
    assert json.loads(fixed.stdout)["positions_mm"] == first
