"""The command `design-sensors`, run as a user runs it."""

import json
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import onnx
import pytest

from beamtouch_models import cli, runtime
from beamtouch_models.runtime import ModelFile
from beamtouch_models.runtime.description import summary
from support.pages.tags import Tags
from support.programs.in_process import Command
from support.surfaces.example_scenes import SCENES


def test_help_of_every_command_imports_nothing_that_computes() -> None:
    program = """if True:
        import sys
        from contextlib import suppress
        from beamtouch_models import cli
        for command in cli.COMMANDS:
            with suppress(SystemExit):
                cli.main([command, "--help"])
        print(sorted({"numpy", "scipy", "onnx", "onnxruntime", "rich"} & set(sys.modules)), file=sys.stderr)
    """
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False, timeout=150)
    assert (done.returncode, done.stderr) == (0, "[]\n")
    assert done.stdout.count("usage: design-sensors ") == len(cli.COMMANDS)


def test_build_writes_a_model_and_a_daemon_config_and_prints_one_json_object(
    design_sensors_roughly: Command, tmp_path: Path
) -> None:
    model, config = tmp_path / "press.onnx", tmp_path / "daemon.toml"
    asked = ("--sensors", 3, "--seed", 7, "--json", "--daemon-config", config)
    done = design_sensors_roughly("build", SCENES / "paper.toml", "-o", model, *asked)
    assert done.returncode == 0, done.stderr
    described = json.loads(done.stdout)
    assert len(described["positions_mm"]) == 3
    assert described["channels"] == ["s1", "s2", "s3"]
    assert described["seed"] == 7
    assert described["max_deflection_mm"] == pytest.approx(1.1287477954, rel=1e-9)
    assert described["noise_mm"] == pytest.approx(0.02 * 1.1287477954, rel=1e-9)
    assert described["outputs"] == ["position_mm", "position_low_mm", "position_high_mm", "contact_log_odds", "misfit"]
    drift_mm_per_min = pytest.approx(described["noise_mm"])  # more than 5 um, and the scene states none
    assert described["floor"] == {"gain": [0.0] * 3, "zero_mm": [0.0] * 3, "drift_mm_per_min": drift_mm_per_min}
    assert len(described["thresholds"]["touch"]) == 3
    assert described["accuracy"]["ratio"] < 1.3
    assert runtime.load(model).identity == described["model"]
    surface = tomllib.loads(config.read_text())["surfaces"]["paper"]
    assert [channel["name"] for channel in surface["channels"]] == described["channels"]
    assert surface["beam"] == described["beam"]
    token = tmp_path / "beamtouch.token"
    assert token.stat().st_mode & 0o777 == 0o600
    assert len(token.read_text().strip()) >= 32
    assert sorted(path.name for path in tmp_path.iterdir()) == ["beamtouch.token", "daemon.toml", "press.onnx"]
    placed = described["placed"]
    assert (placed["criterion"], placed["failed_percent"]) == ("position-error", 10)
    assert len(placed["limit_without_percent"]) == 3
    assert json.loads(design_sensors_roughly("inspect", model, "--json").stdout) == described


@pytest.mark.promise("docs/how-to/upgrade.md", "A service refuses a model of another schema.")
def test_an_old_model_is_refused_with_the_command_that_rebuilds_it_for_its_mounted_sensors(
    design_sensors_roughly: Command, quick_model: Path, tmp_path: Path
) -> None:
    old, path = onnx.load(quick_model), tmp_path / "quick.onnx"
    entries = {entry.key.rpartition(".")[2]: entry for entry in old.metadata_props}
    entries["schema_version"].value = "1"
    layout = json.loads(entries["layout"].value)
    layout[0]["position_mm"] = 90.5  # where the installer put it
    kept_mm = [channel["position_mm"] for channel in layout]
    entries["layout"].value = json.dumps(layout)
    scene = json.loads(entries["scene"].value).replace("count = 3", "count = 3\ngrid_mm = 19")
    entries["scene"].value = json.dumps(scene)
    old.metadata_props.remove(entries["placed"])  # what no file of that version has
    onnx.save(old, path)

    refused = design_sensors_roughly("inspect", path)
    command = re.search(r"`design-sensors (build [^`]*)`", refused.stderr)
    assert (refused.returncode, command and command[1]) == (2, f"build {path} -o {path}")

    anew = ("build", path, "-o", tmp_path / "new.onnx", "--criterion", "eigenvalue-product", "--json")
    assert all(place % 19 == 0 for place in json.loads(design_sensors_roughly(*anew).stdout)["positions_mm"])
    report = tmp_path / "report.html"
    rebuilt = json.loads(design_sensors_roughly("build", path, "-o", path, "--report", report, "--json").stdout)
    assert rebuilt["positions_mm"] == kept_mm
    assert rebuilt["placed"]["criterion"] == "eigenvalue-product"
    assert runtime.load(path).identity == rebuilt["model"]
    assert "the model's" in " ".join(Tags(report.read_text()).text)  # no search finds its layout


def test_inspect_for_a_person(design_sensors_here: Command, bench_model: Path) -> None:
    done = design_sensors_here("inspect", bench_model)
    assert done.returncode == 0
    for said in (
        "gains +- 0.3 %, zeros +- 1 um",
        "false contacts while nothing touches: one in 30 days",
        "s1 68, s2 156, s3 244, s4 332 mm",
        "error over limit",
    ):
        assert said in done.stdout
    assert max(map(len, done.stdout.splitlines())) <= 100


def test_the_floor_is_told_to_two_digits_or_as_a_range(bench: ModelFile) -> None:
    floor = bench.metadata.floor.model_copy(update={"gain": [0.0123] * 4, "zero_mm": [0.0011, 0.0028, 0.002, 0.002]})
    text = summary(bench.metadata.model_copy(update={"floor": floor}), "bench", [])
    assert "gains +- 1.2 %, zeros +- 1.1..2.8 um" in text
