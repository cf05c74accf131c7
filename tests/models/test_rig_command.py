"""The command `beamtouch-rig`, run as a user runs it: version, wrong arguments, and the two ways to stop it."""

import signal
import socket
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import pytest

from example_scenes import SCENES

RIG = str(Path(sys.executable).parent / "beamtouch-rig")
SCENE = str(SCENES / "bench.toml")


def rig(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([RIG, *arguments], capture_output=True, text=True, timeout=60, check=False)


def test_it_prints_its_version() -> None:
    done = rig("--version")
    assert (done.returncode, done.stdout) == (0, f"beamtouch-rig {version('beamtouch')}\n")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ((), "the following arguments are required: SCENE, --model"),
        ((SCENE, "--model", "m.onnx"), "one of the arguments --modbus-tcp --modbus-rtu --serial is required"),
        ((SCENE, "--model", "m.onnx", "--modbus-tcp", "5020"), "'5020' is not HOST:PORT"),
        ((SCENE, "--model", "m.onnx", "--modbus-tcp", "rig..plant:0"), "'rig..plant:0' is not HOST:PORT"),
        (
            (SCENE, "--model", "m.onnx", "--serial", "line", "--seed", "-1"),
            "'-1' is not a whole number from 0 to 4294967295",
        ),
    ],
)
def test_wrong_arguments_are_one_line_and_exit_2(arguments: tuple[str, ...], said: str) -> None:
    done = rig(*arguments)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert said in done.stderr


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 0)])
def test_ctrl_c_is_130_and_sigterm_is_0_and_both_remove_the_line(
    bench_model: Path, tmp_path: Path, number: signal.Signals, code: int
) -> None:
    line = tmp_path / "line"
    command = [RIG, SCENE, "--model", str(bench_model), "--serial", str(line)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout
        assert process.stderr
        try:
            assert process.stdout.readline() == f"listening on serial {line}\n"
            process.send_signal(number)
            assert process.wait(60) == code
            assert process.stderr.read() == ""
        finally:
            process.kill()
    assert not line.is_symlink()


def test_a_port_that_is_taken_is_named(bench_model: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        where = f"127.0.0.1:{taken.getsockname()[1]}"
        done = rig(SCENE, "--model", str(bench_model), "--modbus-tcp", where)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith(
        f"beamtouch-rig: cannot listen on {where}: in use; stop the program that listens there"
    )


def test_an_address_of_another_machine_is_named(bench_model: Path) -> None:
    done = rig(SCENE, "--model", str(bench_model), "--modbus-tcp", "192.0.2.1:5020")
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("beamtouch-rig: cannot listen on 192.0.2.1:5020: not on this machine; use 127.0.0.1")


def test_a_truth_file_without_a_folder_is_refused_before_anything_listens(bench_model: Path, tmp_path: Path) -> None:
    truth = tmp_path / "absent" / "truth.csv"
    done = rig(SCENE, "--model", str(bench_model), "--modbus-tcp", "127.0.0.1:0", "--truth", str(truth))
    said = f"beamtouch-rig: {truth.parent}: no such folder; create it first\n"
    assert (done.returncode, done.stdout, done.stderr) == (2, "", said)
