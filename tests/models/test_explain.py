"""The command `design-sensors explain`, run as a user runs it."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from example_scenes import PAPER, SCENES
from in_process import Command

NAMES = [
    "shear",
    "contact width",
    "self-weight",
    "overhang",
    "steps",
    "foundation",
    "dynamics",
    "sensor curve",
    "ADC steps",
    "gain error",
    "zero drift",
    "mounting tolerance",
    "expansion",
    "sensor drift",
]


def explain(*arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "beamtouch_models.cli", "explain", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=100)


def test_one_json_object_holds_every_effect() -> None:
    done = explain(SCENES / "short-deep.toml", "--json")
    assert (done.returncode, done.stderr) == (0, "")
    explained = json.loads(done.stdout)
    assert [effect["name"] for effect in explained["effects"]] == NAMES
    assert explained["noise_mm"] == pytest.approx(0.001 / 10**0.5)
    shear = explained["effects"][0]
    assert shear["included"]
    assert shear["verdict"] == "in"
    assert shear["price"] > 10
    assert shear["cost_us"] == pytest.approx(shear["with_us"] - shear["without_us"])
    assert min(shear["with_us"], shear["without_us"]) > 0
    unstated = {effect["name"]: effect for effect in explained["effects"]}["sensor curve"]
    assert (unstated["price"], unstated["included"], unstated["cost_us"]) == (None, False, None)


def test_a_table_lists_every_effect(design_sensors_here: Command) -> None:
    done = design_sensors_here("explain", SCENES / "wide-contact.toml")
    assert done.returncode == 0
    rows = {line.strip().split("  ")[0]: line for line in done.stdout.splitlines()}
    assert set(NAMES) <= set(rows)
    assert " in " in rows["contact width"]
    assert " out " in rows["foundation"]
    assert "price: in units of a sample's noise, 0.00537 mm" in done.stdout
    # Where the output is no terminal, whole lines and names of keys stay together; how much room there is depends on
    # the times that were measured.
    assert "…" not in done.stdout
    assert "give environment.temperature_range_k and" in rows["sensor drift"]


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("[beam]", "[beam]\nsupports = [{at_mm = 100}]", "one simple support lets the beam rotate: add a support"),
        ("[beam]", "[beam]\nsupports = [{at_mm = 100, kin = 'fixed'}]", "unknown key beam.supports[0].kin"),
        ("[beam]", "[beam]\nsegments = [{to_mm = 300}]", "they must cover it exactly"),
        ("[beam]", "[beam]\nfoundation_n_mm2 = 1e30", "too stiff beside this beam"),
        ("force_n = 10.0", "force_n = 300", "small-angle theory"),
        ("noise_percent_of_max = 2", "noise_mm = 0", "a noise of 0"),
        ("position_mm", "width_mm = -1\nposition_mm", "contact.width_mm"),
    ],
)
def test_a_bad_scene_is_one_line_and_exit_2(
    design_sensors_here: Command, tmp_path: Path, old: str, new: str, said: str
) -> None:
    scene = tmp_path / "scene.toml"
    scene.write_text(PAPER.replace(old, new, 1))
    done = design_sensors_here("explain", scene, "--json")
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert said in done.stderr
