"""`design-sensors new` and `scenes`: what they write loads and builds, and nothing is overwritten."""

import json
import shlex
import tomllib
from itertools import product
from pathlib import Path

import pytest

from beamtouch_models.design.scene import load_scene
from support.programs.in_process import Command
from support.surfaces.example_scenes import SCENES

STRIP = ("--length-mm", 650, "--width-mm", 40, "--thickness-mm", 2)
BLOCK = ("--length-mm", 100, "--width-mm", 10, "--thickness-mm", 8)
STANDING = [pair for pair in product(("clamped", "pinned", "roller", "free"), repeat=2) if "clamped" in pair]
STANDING += [("pinned", "pinned"), ("pinned", "roller"), ("roller", "pinned")]


@pytest.mark.parametrize(("left", "right"), STANDING)
@pytest.mark.parametrize("size", [(*STRIP, "--material", "stainless"), (*BLOCK, "--material", "acrylic")])
def test_a_scene_of_any_ends_can_be_built(
    design_sensors_here: Command, tmp_path: Path, left: str, right: str, size: tuple[object, ...]
) -> None:
    path = tmp_path / "strip.toml"
    done = design_sensors_here("new", path, *size, "--left", left, "--right", right)
    assert done.returncode == 0, done.stderr
    done = design_sensors_here("explain", path, "--json")
    assert done.returncode == 0, done.stderr
    (expansion,) = (one for one in json.loads(done.stdout)["effects"] if one["name"] == "expansion")
    can_lengthen = "the beam can lengthen: at most one support holds it" in expansion["reason"]
    assert can_lengthen is not ({left, right} <= {"clamped", "pinned"})


def test_rollers_places_of_contacts_and_housings_are_those_of_the_command(
    design_sensors_here: Command, tmp_path: Path
) -> None:
    options = ("--roller-mm", 400, "--roller-mm", 200, "--position-mm", 60, 400, "--size-mm", 18, "--noise-mm", 0.003)
    done = design_sensors_here("new", tmp_path / "strip.toml", *STRIP, *options)
    assert done.returncode == 0, done.stderr
    scene, text = load_scene(tmp_path / "strip.toml")
    assert [support.at_mm for support in scene.beam.support_list] == [0, 200, 400, 650]
    assert text.count("on a roller") == 3
    assert (scene.contact.position_mm, scene.sensors.size_mm) == ((60, 400), 18)
    assert "# zero_drift_mm = 0.0006 " in text


def test_what_comes_next_can_be_pasted(
    design_sensors_roughly: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    done = design_sensors_roughly("new", "a strip.toml", *STRIP, "--sensors", 2)
    assert "design-sensors build 'a strip.toml' -o MODEL.onnx" in done.stdout
    files = ("-o", "a strip.onnx", "--daemon-config", "a daemon.toml")
    done = design_sensors_roughly("build", "a strip.toml", *files, "--criterion", "eigenvalue-product")
    lines = [shlex.split(line) for line in done.stderr.removeprefix("try it:").splitlines()[:3]]
    assert lines[0][:4] == ["beamtouch-rig", "a strip.toml", "--model", "a strip.onnx"]
    assert lines[1][:4] == ["beamtouch-service", "run", "--model", "a strip.onnx"]
    assert lines[2] == ["beamtouch-daemon", "run", "a daemon.toml"]


def test_every_commented_key_is_one(design_sensors_here: Command, tmp_path: Path) -> None:
    assert design_sensors_here("new", tmp_path / "strip.toml", *STRIP).returncode == 0
    text = (tmp_path / "strip.toml").read_text()
    bare = [line.removeprefix("# ") for line in text.splitlines() if line.startswith(("# [", "#")) and " = " in line]
    table = {key: part for part in ("beam", "sensors", "requirements", "environment") for key in _keys(part)}
    assert len(bare) >= 8
    for line in bare:
        assert line.split(" = ")[0] in table, line
        tomllib.loads(line)


def _keys(part: str) -> set[str]:
    scene, _ = load_scene(SCENES / "bench.toml")
    return set(type(getattr(scene, part)).model_fields)


def test_a_file_is_replaced_only_by_force(
    design_sensors_here: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("bench.toml").write_text("mine")
    for arguments in (("new", "bench.toml", *STRIP), ("scenes", "--copy", "bench")):
        done = design_sensors_here(*arguments)
        assert (done.returncode, Path("bench.toml").read_text()) == (2, "mine")
        assert done.stderr.endswith("bench.toml exists already; give --force to replace it\n")
    assert design_sensors_here("scenes", "--copy", "bench", "--force").returncode == 0
    assert Path("bench.toml").read_bytes() == (SCENES / "bench.toml").read_bytes()
    assert design_sensors_here("new", "bench.toml", *STRIP, "--force").returncode == 0
    assert load_scene(Path("bench.toml"))[0].beam.length_mm == 650


def test_scenes_are_listed_with_what_they_are(design_sensors_here: Command, tmp_path: Path) -> None:
    printed = design_sensors_here("scenes").stdout
    told = json.loads(design_sensors_here("scenes", "--json").stdout)["scenes"]
    assert list(told) == sorted(path.stem for path in SCENES.glob("*.toml"))
    assert all(len(words.split()) > 7 for words in told.values())
    assert printed.split() == [word for name, words in told.items() for word in (name, *words.split())]
    assert max(map(len, printed.splitlines())) <= 100
    done = design_sensors_here("scenes", "--copy", "paper", tmp_path, "--json")
    assert json.loads(done.stdout) == {"copied": str(tmp_path / "paper.toml")}
