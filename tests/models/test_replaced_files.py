"""What a person has edited or measured, or named by mistake, is replaced only when asked; a plain rebuild runs."""

import json
import shutil
from pathlib import Path

import numpy as np
import onnx
import pytest

import beamtouch_models as models
from beamtouch_models.runtime import ModelFile
from models.calibration_files import write_readings
from support.programs.in_process import Command
from support.surfaces.deflections import deflections_of
from support.surfaces.example_scenes import PAPER, SCENES

FORCE = "name another file, or add --force to replace it"


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    path = tmp_path / "strip.toml"
    path.write_text(PAPER.replace("count = 2", "count = 2\ngrid_mm = 57"))
    return path


@pytest.mark.soak
@pytest.mark.promise(
    "docs/how-to/spare-part.md",
    "`build` replaces neither a calibrated model nor an edited `daemon.toml`.",
)
@pytest.mark.promise(
    "docs/how-to/design.md",
    "A build replaces its own files without asking, but not your work.",
    "somebody has edited the configuration since `build` wrote it (its last line tells), `build` ends with one line "
    "and exit code 2, and writes nothing.",
)
def test_a_configuration_is_replaced_until_somebody_has_edited_it(
    design_sensors_roughly: Command, scene: Path, tmp_path: Path
) -> None:
    model, config, report = tmp_path / "strip.onnx", tmp_path / "daemon.toml", tmp_path / "strip.html"
    asked = ("build", scene, "-o", model, "--daemon-config", config, "--report", report)
    config.touch()
    for line_end in (b"\n", b"\r\n"):
        assert design_sensors_roughly(*asked).returncode == 0
        config.write_bytes(config.read_bytes().replace(b"\n", line_end))
    assert design_sensors_roughly(*asked).returncode == 0
    edited = config.read_text().replace('host = "127.0.0.1"', 'host = "192.168.0.7"')
    assert edited != config.read_text()
    config.write_text(edited)
    built = model.read_bytes()
    scene.write_text(scene.read_text().replace("width_mm = ", "width_mm = 1"))
    refused = design_sensors_roughly(*asked)
    assert (refused.returncode, refused.stdout) == (2, "")
    assert refused.stderr == f"design-sensors: {config}: it is not as build wrote it; {FORCE}\n"
    assert (config.read_text(), model.read_bytes()) == (edited, built)
    assert design_sensors_roughly(*asked, "--force").returncode == 0
    assert 'host = "127.0.0.1"' in config.read_text()
    assert model.read_bytes() != built


@pytest.mark.soak
@pytest.mark.promise(
    "docs/how-to/spare-part.md",
    "`build` replaces neither a calibrated model nor an edited `daemon.toml`.",
)
def test_a_model_may_be_calibrated_in_place_and_is_then_not_replaced_by_a_build_without_a_word(
    design_sensors_roughly: Command, bench: ModelFile, bench_model: Path, tmp_path: Path
) -> None:
    model, loads = tmp_path / "bench.onnx", (np.linspace(20.0, 380.0, 5), np.full(5, 12.0))
    path = write_readings(tmp_path / "loads.csv", bench, deflections_of(bench, *loads), *loads)
    shutil.copy(bench_model, model)
    assert design_sensors_roughly("calibrate", model, path, "-o", model).returncode == 0
    calibrated, scene = model.read_bytes(), SCENES / "bench.toml"
    said = f"design-sensors: {model}: it is calibrated, and a new build is not; "
    for asked, instead in (
        (("build", scene, "-o", model), FORCE),
        (("build", model, "-o", model), FORCE),
        (("trade", scene, "-o", tmp_path, "--latency-ms", 20), "name another folder"),
    ):
        refused = design_sensors_roughly(*asked)
        assert (refused.returncode, refused.stderr) == (2, f"{said}{instead}\n")
    # Only a model may take the place of the one that is rebuilt.
    report = design_sensors_roughly("build", model, "-o", tmp_path / "new.onnx", "--report", model, "--force")
    said = f"design-sensors: {model}: the command reads this file as well; name another one\n"
    assert (report.returncode, report.stderr) == (2, said)
    assert model.read_bytes() == calibrated
    assert design_sensors_roughly("build", model, "-o", model, "--force").returncode == 0
    assert models.load_model(model).metadata.calibration is None


def with_metadata(path: Path, entries: dict[str, str]) -> Path:
    model = onnx.ModelProto()
    for key, value in entries.items():
        model.metadata_props.add(key=key, value=value)
    path.write_bytes(model.SerializeToString())
    return path


@pytest.mark.parametrize(
    "stated",
    [
        {"layout": f'[{{"position_mm": {"1" * 400}}}]'},
        {"layout": "[" * 9999},
        {"layout": "5"},
        {"scene": "5"},
        {"scene": "null"},
        {"name": "null"},
        {"name": '"a\\n[x]"'},
        {"placed": "7"},
    ],
    ids=lambda stated: next(f"{key} {value[:12]}" for key, value in stated.items()),
)
def test_a_model_file_that_states_nonsense_is_no_scene_and_is_not_replaced_by_one(
    stated: dict[str, str], design_sensors_here: Command, scene: Path, tmp_path: Path
) -> None:
    sound = {"layout": '[{"position_mm": 100.0}]', "scene": json.dumps(scene.read_text()), "name": '"bench"'}
    odd = with_metadata(tmp_path / "odd.onnx", {f"beamtouch.{key}": text for key, text in (sound | stated).items()})
    before = odd.read_bytes()
    asked = design_sensors_here("build", odd, "-o", tmp_path / "new.onnx")
    said = f"design-sensors: {odd}: it is not a model file that holds its scene; give a scene (TOML)\n"
    assert (asked.returncode, asked.stderr) == (2, said)
    if "layout" in stated and stated["layout"].startswith("[["):
        refused = design_sensors_here("build", scene, "-o", odd)
        assert (refused.returncode, odd.read_bytes()) == (2, before)


def test_a_file_that_was_named_by_mistake_is_not_replaced(
    design_sensors_here: Command, bench: ModelFile, bench_model: Path, scene: Path, tmp_path: Path
) -> None:
    loads = write_readings(tmp_path / "loads.csv", bench, np.zeros((10, 4)))
    other, page, recorded = tmp_path / "other.toml", tmp_path / "page.html", loads.read_bytes()
    other.write_text(PAPER)
    page.write_text("<!doctype html>\n<title>Not ours</title>\n")
    theirs = with_metadata(tmp_path / "theirs.onnx", {"layout": "NCHW"})
    unread, no_report = "it is there, and cannot be read as a model file", "it is not a report of build"
    for asked, said in (
        (("build", scene, "-o", other), f"{other}: {unread}; {FORCE}"),
        (("build", scene, "-o", loads), f"{loads}: {unread}; {FORCE}"),
        (("build", scene, "-o", theirs), f"{theirs}: {unread}; {FORCE}"),
        (
            ("build", scene, "-o", tmp_path / "m.onnx", "--report", loads),
            f"{loads}: {no_report}; {FORCE}",
        ),
        (("build", scene, "-o", tmp_path / "m.onnx", "--report", page), f"{page}: {no_report}; {FORCE}"),
        (("calibrate", bench_model, tmp_path / "more.csv", "-o", loads), f"{loads}: {unread}; name another file"),
    ):
        refused = design_sensors_here(*asked)
        assert (refused.returncode, refused.stderr) == (2, f"design-sensors: {said}\n")
    assert (other.read_text(), loads.read_bytes()) == (PAPER, recorded)
