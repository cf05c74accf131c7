"""`design-sensors new` and `scenes`: what they write loads and builds, and nothing is overwritten."""

import json
import tomllib
from itertools import product
from pathlib import Path

import pytest

from beamtouch_models.building.new_scene import Answers, End, scene_text
from beamtouch_models.commands.scenes import described, shipped_scenes
from beamtouch_models.physics.axial import holding_mm
from beamtouch_models.scene import load_scene, parse_scene
from beamtouch_models.scene.materials import MaterialName
from beamtouch_models.surface import Surface
from example_scenes import SCENES
from in_process import Command

STRIP = ("--length-mm", 650, "--width-mm", 40, "--thickness-mm", 2)
STANDING = [pair for pair in product(("clamped", "pinned", "roller", "free"), repeat=2) if "clamped" in pair]
STANDING += [("pinned", "pinned"), ("pinned", "roller"), ("roller", "pinned")]


@pytest.mark.parametrize(("left", "right"), STANDING)
@pytest.mark.parametrize("size_mm", [(650.0, 40.0, 2.0), (100.0, 10.0, 8.0)])
def test_a_scene_of_any_ends_can_be_built(left: End, right: End, size_mm: tuple[float, float, float]) -> None:
    material: MaterialName = "acrylic" if size_mm[0] < 200 else "stainless"
    scene = parse_scene(scene_text(Answers(*size_mm, material=material, left=left, right=right), "x"), "x.toml")
    Surface.of(scene).check()
    assert (len(holding_mm(scene.beam)) > 1) == ({left, right} <= {"clamped", "pinned"})


def test_a_roller_between_the_ends_carries_the_beam(
    design_sensors_here: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    done = design_sensors_here("new", "strip.toml", *STRIP, "--roller-mm", 400, "--roller-mm", 200)
    assert done.returncode == 0, done.stderr
    scene, text = load_scene(Path("strip.toml"))
    assert [support.at_mm for support in scene.beam.support_list] == [0, 200, 400, 650]
    Surface.of(scene).check()
    assert text.count("on a roller") == 3


def test_places_of_contacts_and_housings_are_those_of_the_command(
    design_sensors_here: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    done = design_sensors_here("new", "a.toml", *STRIP, "--position-mm", 60, 400, "--size-mm", 18, "--noise-mm", 0.003)
    assert done.returncode == 0, done.stderr
    scene, text = load_scene(Path("a.toml"))
    assert (scene.contact.position_mm, scene.sensors.size_mm) == ((60, 400), 18)
    assert "# zero_drift_mm = 0.0006 " in text


def test_every_commented_key_is_one() -> None:
    text = scene_text(Answers(*(650.0, 40.0, 2.0)), "x")
    bare = [line.removeprefix("# ") for line in text.splitlines() if line.startswith(("# [", "#")) and " = " in line]
    table = {key: part for part in ("beam", "sensors", "requirements", "environment") for key in _keys(part)}
    assert len(bare) >= 8
    for line in bare:
        assert line.split(" = ")[0] in table, line
        tomllib.loads(line)


def _keys(part: str) -> set[str]:
    scene, _ = load_scene(SCENES / "bench.toml")
    return set(type(getattr(scene, part)).model_fields)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("a.toml",), "arguments are required: --length-mm, --width-mm, --thickness-mm"),
        (("a.txt", *STRIP), "a.txt: give the scene a name that ends in .toml"),
        (("a.toml", *STRIP[:4], "--thickness-mm", 0.002), "beam.thickness_mm = 0.002 is too small for a beam; if it"),
        (("a.toml", *STRIP[:4], "--thickness-mm", "nan"), "--thickness-mm nan: give millimetres, more than 0"),
        (("a.toml", *STRIP, "--left", "free"), "--left free --right roller: supports: one simple support lets"),
        (
            ("a.toml", *STRIP, "--roller-mm", 650),
            "--right roller --roller-mm 650: supports at [0.0, 650.0, 650.0] mm: two",
        ),
        (("a.toml", *STRIP, "--roller-mm", "nan"), "--roller-mm nan: must be a finite number"),
        (("a.toml", *STRIP, "--force-n", 1, 1e6), "at 1e+06 N the beam slopes by"),
        (("a.toml", *STRIP, "--position-mm", 60, 700), "--position-mm 60 700: give two places on the beam, 0..650 mm"),
        (("a.toml", *STRIP, "--material", "steal"), "invalid choice: 'steal' (choose from steel, "),
    ],
)
def test_what_is_no_scene_is_refused_in_one_line(
    design_sensors_here: Command,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    arguments: tuple[object, ...],
    said: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    done = design_sensors_here("new", *arguments)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert said in done.stderr
    assert not list(tmp_path.iterdir())


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
    lines = design_sensors_here("scenes").stdout.splitlines()
    assert [line.split()[0] for line in lines] == sorted(path.stem for path in SCENES.glob("*.toml"))
    assert all(len(line.split()) > 8 for line in lines)
    told = json.loads(design_sensors_here("scenes", "--json").stdout)["scenes"]
    assert told == {name: described(path) for name, path in shipped_scenes().items()}
    done = design_sensors_here("scenes", "--copy", "paper", tmp_path, "--json")
    assert json.loads(done.stdout) == {"copied": str(tmp_path / "paper.toml")}
    for wrong, said in ((("papr",), "choose from bench, "), (("paper", "a", "b"), "b is one too many")):
        done = design_sensors_here("scenes", "--copy", *wrong)
        assert (done.returncode, done.stderr.count("\n")) == (2, 1)
        assert said in done.stderr
