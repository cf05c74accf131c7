"""The command `design-sensors`, run as a user runs it."""

import json
import re
import subprocess
import sys
import tomllib
from importlib.metadata import version
from pathlib import Path

import onnx
import pytest

from beamtouch_models import modelfile
from example_scenes import PAPER, SCENES
from in_process import Command
from waiting import interrupted


def design_sensors(*arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "beamtouch_models.cli", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=150)


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
    assert done.stdout.count("usage: design-sensors ") == 11


def test_build_writes_a_model_and_a_daemon_config_and_prints_one_json_object(tmp_path: Path) -> None:
    model, config = tmp_path / "press.onnx", tmp_path / "daemon.toml"
    done = design_sensors(
        "build", SCENES / "paper.toml", "-o", model, "--sensors", 3, "--seed", 7, "--json", "--daemon-config", config
    )
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
    inspected = design_sensors("inspect", model, "--json")
    assert inspected.returncode == 0
    assert json.loads(inspected.stdout) == described


@pytest.mark.long
def test_an_old_model_is_refused_with_the_command_that_rebuilds_it(bench_model: Path, tmp_path: Path) -> None:
    old = onnx.load(bench_model)
    (entry,) = (entry for entry in old.metadata_props if entry.key == "beamtouch.schema_version")
    entry.value = "1"
    (placed,) = (entry for entry in old.metadata_props if entry.key == "beamtouch.placed")
    old.metadata_props.remove(placed)  # what no file of that version has
    path = tmp_path / "bench.onnx"
    onnx.save(old, path)
    refused = design_sensors("inspect", path)
    assert refused.returncode == 2
    command = re.search(r"`design-sensors (build [^`]*)`", refused.stderr)
    assert command is not None
    done = design_sensors(*command[1].split())
    assert done.returncode == 0, done.stderr
    assert path.read_bytes() == bench_model.read_bytes()


@pytest.mark.usefixtures("short_measuring")
def test_a_rebuilt_model_keeps_its_layout_because_its_sensors_are_mounted(
    design_sensors_here: Command, bench_model: Path, tmp_path: Path
) -> None:
    old = onnx.load(bench_model)
    for entry in old.metadata_props:
        if entry.key == "beamtouch.layout":
            moved = json.loads(entry.value)
            moved[0]["position_mm"] = 70.5  # where the installer put it
            entry.value = json.dumps(moved)
    path, fresh = tmp_path / "bench.onnx", tmp_path / "new.onnx"
    onnx.save(old, path)
    done = design_sensors_here("build", path, "-o", fresh, "--json")
    assert done.returncode == 0, done.stderr
    rebuilt = json.loads(done.stdout)
    assert rebuilt["positions_mm"] == [70.5, 156, 244, 332]
    assert rebuilt["placed"]["criterion"] == "eigenvalue-product"
    asked = ("--criterion", "eigenvalue-product")
    anew = json.loads(design_sensors_here("build", path, "-o", fresh, *asked, "--json").stdout)
    assert anew["positions_mm"] == [68, 156, 244, 332]


@pytest.mark.usefixtures("short_measuring")
@pytest.mark.parametrize(
    ("count", "options", "said"),
    [
        (1, (), "one failed sensor ends this surface: it has no other; add one\n"),
        (2, (), "one failed sensor ends this surface: all 2 channels must work; add a sensor, or place them with"),
        (2, ("--spare", 1), "one failed sensor ends this surface: all 2 channels must work; add a sensor\n"),
        (4, ("--spare", 1), ""),
    ],
)
def test_build_warns_where_one_failed_sensor_ends_the_surface(
    design_sensors_here: Command,
    tmp_path: Path,
    count: int,
    options: tuple[object, ...],
    said: str,
) -> None:
    scene = tmp_path / "scene.toml"
    text = PAPER.replace("count = 2", f"count = {count}\ngrid_mm = 57").replace(
        "force_n = 10.0", "force_n = [2.0, 20.0]"
    )
    scene.write_text(text.replace("noise_percent_of_max = 2", "noise_percent_of_max = 0.2"))
    done = design_sensors_here("build", scene, "-o", tmp_path / "model.onnx", "--json", *options)
    assert done.returncode == 0, done.stderr
    warnings = [line + "\n" for line in done.stderr.splitlines() if line.startswith("warning:")]
    assert len(warnings) == (1 if said else 0)
    assert said in "".join(warnings)
    described = json.loads(done.stdout)
    assert described["placed"]["spare"] == (1 if options else 0)
    assert (described["min_channels"] == count) == bool(said)


def test_a_file_without_a_scene_cannot_be_rebuilt(design_sensors_here: Command, tmp_path: Path) -> None:
    (tmp_path / "no.onnx").write_bytes(b"no model")
    done = design_sensors_here("build", tmp_path / "no.onnx", "-o", tmp_path / "new.onnx")
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert "not a model file that holds its scene" in done.stderr


def test_inspect_for_a_person(design_sensors_here: Command, bench_model: Path) -> None:
    done = design_sensors_here("inspect", bench_model)
    assert "gains +- 0.3 %, zeros +- 1 um" in done.stdout
    assert "false contacts at rest: one in 30 days" in done.stdout
    assert done.returncode == 0
    assert "s1 68, s2 156, s3 244, s4 332 mm" in done.stdout
    assert "error over limit" in done.stdout


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("[beam]", "[beam]\ncolour = 3", "unknown key beam.colour"),
        ("length_mm = 400", "length_mm = -400", "beam.length_mm"),
        ("count = 2", "count = 2\nrange_mm = [1, 4]\nstandoff_mm = 0.5", "standoff_mm = 0.5 lies outside range_mm"),
        ("count = 2", "count = 2\nrange_mm = [1, 2]", "leaves sensors.range_mm"),
        ("force_n = 10.0", "force_n = 300", "small-angle theory"),
        ("noise_percent_of_max = 2", "noise_mm = 0", "a noise of 0"),
        ("count = 2", 'count = "auto"', "position_error_mm"),
        ("count = 2", "count = 2\nfixed_mm = [100, 200, 300]", "more than the 2 to be placed"),
    ],
)
def test_a_bad_scene_is_one_line_exit_2_and_nothing_written(
    design_sensors_here: Command, tmp_path: Path, old: str, new: str, said: str
) -> None:
    scene = tmp_path / "scene.toml"
    scene.write_text(PAPER.replace(old, new))
    output = ("-o", tmp_path / "model.onnx", "--daemon-config", tmp_path / "daemon.toml")
    done = design_sensors_here("build", scene, *output)
    assert done.returncode == 2
    assert said in done.stderr
    assert done.stderr.count("\n") == 1
    assert done.stdout == ""
    assert [path.name for path in tmp_path.iterdir()] == ["scene.toml"]


def test_other_bad_input(design_sensors_here: Command, tmp_path: Path, bench_model: Path) -> None:
    half = tmp_path / "half.onnx"
    half.write_bytes(bench_model.read_bytes()[: bench_model.stat().st_size // 2])
    cases = {
        "damaged or not an ONNX file": ("inspect", half),
        "No such file": ("inspect", tmp_path / "absent.onnx"),
        "no such folder": ("build", SCENES / "paper.toml", "-o", tmp_path / "absent" / "model.onnx"),
        "absent.toml": ("build", tmp_path / "absent.toml", "-o", tmp_path / "model.onnx"),
    }
    for said, arguments in cases.items():
        done = design_sensors_here(*arguments)
        assert (done.returncode, done.stderr.count("\n")) == (2, 1), done.stderr
        assert said in done.stderr


def test_the_number_of_sensors_may_be_left_to_the_requirement(design_sensors_here: Command, tmp_path: Path) -> None:
    scene = tmp_path / "open.toml"
    scene.write_text(PAPER.replace("count = 2", "count = [2, 3]") + "\n[requirements]\nposition_error_mm = 0.01\n")
    done = design_sensors_here("build", scene, "-o", tmp_path / "model.onnx")
    assert done.returncode == 2
    assert "not even 3 sensors reach requirements.position_error_mm" in done.stderr


def test_it_prints_its_version() -> None:
    done = design_sensors("--version")
    assert (done.returncode, done.stdout) == (0, f"design-sensors {version('beamtouch')}\n")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ((), "design-sensors: the following arguments are required: COMMAND"),
        (("guess",), "design-sensors: argument COMMAND: invalid choice: 'guess' (choose from build, "),
        (("build", "scene.toml"), "design-sensors build: the following arguments are required: -o"),
        (("place", "scene.toml", "--sensors", "two"), "'two' is not a whole number from 1 to 64"),
        (("place", "scene.toml", "--seed", "9" * 5000), "is not a whole number from 0 to 4294967295"),
    ],
)
def test_wrong_arguments_are_one_line_and_exit_2(
    design_sensors_here: Command, arguments: tuple[str, ...], said: str
) -> None:
    done = design_sensors_here(*arguments)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert said in done.stderr
    assert "--help" in done.stderr


def test_ctrl_c_is_130_and_leaves_no_model(tmp_path: Path) -> None:
    figures = tmp_path / "figures"
    command = [sys.executable, "-m", "beamtouch_models.cli", "reproduce", "-o", str(figures)]
    assert interrupted(command, lambda _pid: figures.is_dir()) == (130, "", "design-sensors: interrupted\n")
    assert list(figures.iterdir()) == []
