"""The command `design-sensors`, run as a user runs it."""

import json
import re
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import onnx
import pytest

from beamtouch_models import cli, runtime
from beamtouch_models.runtime import ModelFile
from beamtouch_models.runtime.description import per_day, summary
from beamtouch_models.runtime.metadata_parts import (
    Accuracy,
    FilterChoice,
    LayoutErrors,
    Noise,
    Ranges,
    SinceTouch,
    SmallestForce,
)
from support.pages.tags import Tags
from support.programs.in_process import Command
from support.surfaces.example_scenes import SCENES
from support.surfaces.small_model import model_of

ACCURACY = Accuracy(
    error_percent=2.6,
    error_standard_error=0.1,
    limit_percent=2.1,
    limit_standard_error=0.06,
    ratio_standard_error=0.02,
    since_touch=[
        SinceTouch(
            since_ms=since_ms,
            readings=3,
            error_percent=percent,
            error_standard_error=0.1,
            ringing_percent=ringing_percent,
        )
        for since_ms, percent, ringing_percent in ((15, 3.8, 4.7), (40, 2.7, 3.0), (123.4, 2.25, None))
    ],
)
LIMITS_WITHOUT = LayoutErrors(
    criterion="position-error",
    failed_percent=12.5,
    limit_without_percent=[2.9, 4.9, 3.1],
    limit_without_standard_error=[0.05, 0.08, 0.06],
)


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


@pytest.mark.parametrize(
    ("told", "line"),
    [
        ({"accuracy": ACCURACY}, "error 18.2 +- 0.7 mm on average (2.6 % of the length) "),
        ({"accuracy": ACCURACY}, "limit 14.7 +- 0.4 mm, the best possible with these sensors; error over limit 1.24 "),
        ({"accuracy": ACCURACY}, "answer sudden touch: off by 33 mm at 15 ms, 21 mm at 40 ms "),
        ({"accuracy": ACCURACY}, "answer gentle touch: off by 27 mm at 15 ms, 19 mm at 40 ms, 16 mm at 123 ms "),
        ({"noise": Noise(reading_mm=0.0123, sample_mm=0.0045)}, "noise 12.3 um per reading, 4.5 um per sample "),
        (
            {"placed": LIMITS_WITHOUT},
            "failed the limit grows to 34.3 +- 0.6 mm if s2 fails, the worst to lose "
            "placed for the least position error, with the worst sensor failed 12.5 % of the time ",
        ),
        ({"placed": LIMITS_WITHOUT.model_copy(update={"failed_percent": None})}, "for the least position error touch "),
        (
            {"smallest_force": SmallestForce(position_mm=[1, 350, 699], force_n=[2.345, 0.4321, None])},
            "touch smallest force seen: 0.43 N at the best place, 2.3 N and nothing at the ends ",
        ),
        (
            {"smallest_force": SmallestForce(position_mm=[1, 350, 699], force_n=[3.0, 0.5, 3.0])},
            "touch smallest force seen: 0.5 N at the best place, 3 N at the ends ",
        ),
        ({"ranges": Ranges(position_mm=(2.5, 690), force_n=(3, 3))}, "contact from 2.5 to 690 mm, with 3 N, an exact "),
        ({"width_mm": None, "max_deflection_mm": 1.2345}, "beam 700 mm long, bends by up to 1.23 mm; identity beam-1 "),
        (
            {"filter": FilterChoice(kind="growing-mean", window=7, longest=150)},
            "with 7 readings of a load at rest limit",
        ),
        (
            {"filter": FilterChoice(kind="growing-mean", window=7, longest=150)},
            "filter growing-mean of 7 to 150 readings ",
        ),
        ({"filter": FilterChoice(kind="moving-average", window=7)}, "filter moving-average of 7 readings "),
        ({}, "filter none floor "),
        ({}, "sensor linear over gaps of 1 to 4 mm, 3 mm at rest; 12 bits, 200 readings a second "),
    ],
)
def test_inspect_tells_each_figure_with_its_unit(told: dict[str, Any], line: str) -> None:
    metadata = model_of().metadata.model_copy(update={"length_mm": 700.0} | told)
    assert f" {line}" in f" {' '.join(summary(metadata, 'press-7@123456', []).split())} "


@pytest.mark.parametrize(("a_day", "words"), [(2.345, "2.3 a day"), (1.0, "1 a day"), (0.8, "one in 1.25 days")])
def test_false_contacts_are_told_by_the_day_or_by_the_days_between_two(a_day: float, words: str) -> None:
    assert per_day(a_day) == words
