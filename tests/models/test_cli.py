"""The command `design-sensors`, run as a user runs it."""

import json
import re
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
from onnx import numpy_helper

from beamtouch_models import cli, modelfile
from beamtouch_models.building import measure
from beamtouch_models.building.remarks import weak_spot
from beamtouch_models.building.report import page
from beamtouch_models.estimators import estimator
from beamtouch_models.estimators.posterior.window import posterior_graph
from beamtouch_models.modelfile import ModelFile
from example_scenes import PAPER, SCENES
from in_process import Command
from tags import Tags


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


@pytest.mark.usefixtures("short_work")
def test_build_writes_a_model_and_a_daemon_config_and_prints_one_json_object(
    design_sensors_here: Command, tmp_path: Path
) -> None:
    model, config = tmp_path / "press.onnx", tmp_path / "daemon.toml"
    asked = ("--sensors", 3, "--seed", 7, "--json", "--daemon-config", config)
    done = design_sensors_here("build", SCENES / "paper.toml", "-o", model, *asked)
    assert done.returncode == 0, done.stderr
    described = json.loads(done.stdout)
    assert len(described["positions_mm"]) == 3
    assert described["channels"] == ["s1", "s2", "s3"]
    assert described["seed"] == 7
    assert described["max_deflection_mm"] == pytest.approx(1.1287477954, rel=1e-9)
    assert described["noise_mm"] == pytest.approx(0.02 * 1.1287477954, rel=1e-9)
    assert described["outputs"] == ["position_mm", "position_low_mm", "position_high_mm", "contact_log_odds", "misfit"]
    assert described["floor"] == {"gain": [0.0] * 3, "zero_mm": [0.0] * 3}
    assert len(described["thresholds"]["touch"]) == 3
    assert described["accuracy"]["ratio"] < 1.3
    assert modelfile.load(model).identity == described["model"]
    surface = tomllib.loads(config.read_text())["surfaces"]["paper"]
    assert [channel["name"] for channel in surface["channels"]] == described["channels"]
    assert surface["beam"] == described["beam"]
    token = tmp_path / "beamtouch.token"
    assert token.stat().st_mode & 0o777 == 0o600
    assert len(token.read_text().strip()) >= 32
    assert sorted(path.name for path in tmp_path.iterdir()) == ["beamtouch.token", "daemon.toml", "press.onnx"]
    placed = described["placed"]
    assert (placed["criterion"], placed["spare"]) == ("position-error", 0)
    assert len(placed["limit_without_percent"]) == 3
    assert json.loads(design_sensors_here("inspect", model, "--json").stdout) == described


@pytest.mark.usefixtures("short_work")
def test_an_old_model_is_refused_with_the_command_that_rebuilds_it_for_its_mounted_sensors(
    design_sensors_here: Command, quick_model: Path, tmp_path: Path
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

    refused = design_sensors_here("inspect", path)
    command = re.search(r"`design-sensors (build [^`]*)`", refused.stderr)
    assert (refused.returncode, command and command[1]) == (2, f"build {path} -o {path}")

    anew = ("build", path, "-o", tmp_path / "new.onnx", "--criterion", "eigenvalue-product", "--json")
    assert all(place % 19 == 0 for place in json.loads(design_sensors_here(*anew).stdout)["positions_mm"])
    report = tmp_path / "report.html"
    rebuilt = json.loads(design_sensors_here("build", path, "-o", path, "--report", report, "--json").stdout)
    assert rebuilt["positions_mm"] == kept_mm
    assert rebuilt["placed"]["criterion"] == "eigenvalue-product"
    assert modelfile.load(path).identity == rebuilt["model"]
    assert "the model's" in " ".join(Tags(report.read_text()).text)  # no search finds its layout


@pytest.mark.parametrize(
    ("sensors", "fewest", "spare", "said"),
    [
        (1, 1, 0, "one failed sensor ends this surface: it has no other; add one"),
        (2, 2, 0, "one failed sensor ends this surface: all 2 channels must work; add a sensor, or place them with --"),
        (2, 2, 1, "one failed sensor ends this surface: all 2 channels must work; add a sensor"),
        (4, 2, 0, "if s1 fails, the mean position error grows from 1 to 3 % of the length; add a sensor, or place th"),
        (4, 2, 1, "if s1 fails, the mean position error grows from 1 to 3 % of the length; add a sensor"),
    ],
)
def test_what_one_failed_sensor_costs_is_said(
    bench: ModelFile, sensors: int, fewest: int, spare: int, said: str
) -> None:
    metadata, without = bench.metadata, [3.0, 1.1, 1.1, 1.1][:sensors]
    some = {
        "layout": metadata.layout[:sensors],
        "min_channels": fewest,
        "placed": metadata.placed.model_copy(update={"spare": spare, "limit_without_percent": without}),
        "accuracy": metadata.accuracy.model_copy(update={"limit_percent": 1.0}),
    }
    weak = weak_spot(metadata.model_copy(update=some))
    assert weak.startswith(said)
    assert ("--spare" in weak) is ("--" in said or said.endswith("th"))


@pytest.mark.usefixtures("short_work")
def test_a_model_that_misses_its_bounds_is_not_written_by_build_and_is_a_note_of_trade(
    design_sensors_here: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(measure, "MAX_RATIO", 0.1)  # no model is better than the limit
    scene, model = tmp_path / "scene.toml", tmp_path / "model.onnx"
    scene.write_text(PAPER.replace("count = 2", "count = [2, 2]\ngrid_mm = 57"))
    why = "with 0.0226 mm of noise the error is "
    built = design_sensors_here("build", scene, "-o", model)
    assert (built.returncode, built.stdout) == (1, "")
    assert f"design-sensors: nothing was written: {why}" in built.stderr
    assert not model.exists()
    traded = design_sensors_here("trade", scene, "-o", tmp_path / "out", "--draws", 100, "--estimators", "posterior")
    assert why in traded.stderr
    assert "nothing was written" not in traded.stderr


@pytest.mark.usefixtures("short_work")
def test_a_model_with_answers_that_are_not_finite_is_not_written(
    design_sensors_here: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def worn_out(*given: Any, **options: Any) -> onnx.ModelProto:  # noqa: ANN401
        graph = posterior_graph(*given, **options)
        largest = max(graph.graph.initializer, key=lambda one: len(one.raw_data))
        values = np.full_like(numpy_helper.to_array(largest), np.nan)
        largest.CopyFrom(numpy_helper.from_array(values, largest.name))
        return graph

    monkeypatch.setattr(estimator, "posterior_graph", worn_out)
    scene, model = tmp_path / "scene.toml", tmp_path / "model.onnx"
    scene.write_text(PAPER.replace("count = 2", "count = 2\ngrid_mm = 57"))
    built = design_sensors_here("build", scene, "-o", model)
    assert (built.returncode, built.stdout) == (1, "")
    assert "design-sensors: nothing was written: some answers of the model are not finite; check the s" in built.stderr
    assert not model.exists()


@pytest.mark.usefixtures("short_work")
def test_a_build_that_is_interrupted_while_it_measures_for_the_report_leaves_nothing(
    design_sensors_here: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(page, "gather", interrupt)
    scene = tmp_path / "scene.toml"
    scene.write_text(PAPER.replace("count = 2", "count = 2\ngrid_mm = 57"))
    files = ("-o", tmp_path / "m.onnx", "--daemon-config", tmp_path / "d.toml", "--report", tmp_path / "r.html")
    done = design_sensors_here("build", scene, *files)
    assert (done.returncode, done.stdout) == (130, "")
    assert list(tmp_path.iterdir()) == [scene]


def test_inspect_for_a_person(design_sensors_here: Command, bench_model: Path) -> None:
    done = design_sensors_here("inspect", bench_model)
    assert done.returncode == 0
    for said in (
        "gains +- 0.3 %, zeros +- 1 um",
        "false contacts at rest: one in 30 days",
        "s1 68, s2 156, s3 244, s4 332 mm",
        "error over limit",
    ):
        assert said in done.stdout
