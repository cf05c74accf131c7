"""Inputs that `beamtouch-rig --firmware` refuses; tests/system/test_firmware_line.py shows that it works."""

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

from example_scenes import SCENES
from in_process import Command
from simulated_board import Board

RIG = str(Path(sys.executable).parent / "beamtouch-rig")


def refused(*arguments: str | Path) -> str:
    done = subprocess.run([RIG, *map(str, arguments)], capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stdout) == (2, "")
    return done.stderr


def test_the_firmware_needs_a_serial_line(rig_here: Command, ten_bits: tuple[Path, Path]) -> None:
    scene, model = ten_bits
    done = rig_here(scene, "--model", model, "--modbus-tcp", "127.0.0.1:0", "--firmware", "board", "firmware.elf")
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == "beamtouch-rig: --firmware needs --serial\n"


def test_the_scene_must_state_the_adc_of_the_firmware(
    rig_here: Command, built_model: Callable[[str], Path], tmp_path: Path
) -> None:
    serial = ("--serial", tmp_path / "line", "--firmware", "board", "firmware.elf")
    done = rig_here(SCENES / "bench.toml", "--model", built_model("bench"), *serial)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == "beamtouch-rig: the firmware's ADC has 10 bits; set sensors.adc_bits = 10 in the scene\n"


def test_a_missing_board_is_reported_in_one_line(ten_bits: tuple[Path, Path], tmp_path: Path) -> None:
    scene, model = ten_bits
    line, board = tmp_path / "line", tmp_path / "board"
    said = refused(scene, "--model", model, "--serial", line, "--firmware", board, "firmware.elf")
    assert said == f"beamtouch-rig: {board}: No such file or directory\n"


def test_a_board_that_does_not_start_is_named_in_the_message(ten_bits: tuple[Path, Path], tmp_path: Path) -> None:
    scene, model = ten_bits
    said = refused(scene, "--model", model, "--serial", tmp_path / "line", "--firmware", "/bin/false", "firmware.elf")
    assert said == "beamtouch-rig: the simulated board /bin/false did not start\n"


def test_a_board_that_ends_is_reported_and_ends_the_rig(
    board: Board, ten_bits: tuple[Path, Path], tmp_path: Path
) -> None:
    (scene, model), line = ten_bits, tmp_path / "line"
    command = [RIG, *map(str, (scene, "--model", model, "--serial", line, "--firmware", *board.command))]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as rig:
        try:
            assert rig.stdout
            assert rig.stdout.readline() == f"listening on serial {line}\n"
            (child,) = Path(f"/proc/{rig.pid}/task/{rig.pid}/children").read_text().split()
            os.kill(int(child), signal.SIGKILL)
            _, said = rig.communicate(timeout=60)
        finally:
            rig.kill()
    assert (rig.returncode, said) == (2, "beamtouch-rig: the simulated board ended unexpectedly\n")
