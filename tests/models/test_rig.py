"""`beamtouch-rig`: its Modbus device and faults by hand, what it refuses, and the board behind it."""

import os
import signal
import socket
import struct
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from models.rig_process import process_of
from support.programs.in_process import Command
from support.programs.simulated_board import Board
from support.surfaces.example_scenes import SCENES

SCENE = SCENES / "bench.toml"
SIGMA_COUNTS = 79
"""Noise of a reading of the bench, in counts."""

TCP = ("--modbus-tcp", "127.0.0.1:0")
NAMED = ("--serial", "line")


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ((), "one of the arguments --modbus-tcp --modbus-rtu --serial is required"),
        (("--modbus-tcp", "5020"), "'5020' is not HOST:PORT"),
        (("--modbus-tcp", ":5020"), "':5020' is not HOST:PORT, such as 127.0.0.1:5020"),
        (("--modbus-tcp", "127.0.0.1:65536"), "'127.0.0.1:65536' is not HOST:PORT"),
        (("--modbus-tcp", "127.0.0.1:x"), "'127.0.0.1:x' is not HOST:PORT"),
        (("--modbus-tcp", "a b:5020"), "'a b:5020' is not HOST:PORT"),
        ((*TCP, *NAMED), "argument --serial: not allowed with argument --modbus-tcp"),
        ((*TCP, "--modbus-rtu", "line"), "argument --modbus-rtu: not allowed with argument --modbus-tcp"),
        ((*TCP, "--unit", "256"), "'256' is not a whole number from 0 to 255"),
        ((*TCP, "--register", "65536"), "'65536' is not a whole number from 0 to 65535"),
        ((*TCP, "--seed", "4294967296"), "'4294967296' is not a whole number from 0 to 4294967295"),
        ((*TCP, "--function", "5"), "argument --function: invalid choice: 5 (choose from 3, 4)"),
        ((*TCP, "--type", "u8"), "argument --type: invalid choice: 'u8' (choose from u16, i16, u32, i32, f32, f64)"),
        ((*TCP, "--byte-order", "AB"), "invalid choice: 'AB' (choose from ABCD, CDAB, BADC, DCBA)"),
        ((*TCP, "--script", "a", "--by-hand"), "argument --by-hand: not allowed with argument --script"),
        ((*NAMED, "--firmware", "b"), "argument --firmware: expected 2 arguments"),
        (("--modbus-tcp", "192.0.2.1:5020"), "cannot listen on 192.0.2.1:5020: not on this machine; use 127.0.0.1"),
        ((*NAMED, "--seed", "-1"), "'-1' is not a whole number from 0 to 4294967295"),
        ((*TCP, "--truth", "absent/truth.csv"), "absent: no such folder; create it first"),
        ((*NAMED, "--byte-order", "CDAB"), "--byte-order needs --modbus-tcp or --modbus-rtu"),
        (("--modbus-rtu", "line", "--type", "i16"), "counts up to 65535 do not fit --type i16"),
        (("--modbus-rtu", "line", "--register", "65533"), "--register 65533: 4 registers from there go beyond 65535"),
        ((*NAMED, "--firmware", "b", "e", "--fault", "pause"), "only faults of sensors are played"),
        ((*NAMED, "--firmware", "b", "e"), "the firmware's ADC has 10 bits; set sensors.adc_bits = 10 in the scene"),
        ((*TCP, "--firmware", "b", "e"), "--firmware needs --serial"),
        ((*TCP, "--imperfections", "taken", "--truth", "taken"), "taken: the command reads this file as well"),
        ((*NAMED, "--firmware", "b", "taken", "--truth", "taken"), "taken: the command reads this file as well"),
        (("--serial", "absent/line"), "absent/line: No such file or directory"),
        (("--serial", "taken"), "taken: exists already; choose another path or remove the file"),
        ((*NAMED, "--fault", "foo"), "fault foo: no such fault; give unplugged:s1, stuck:s1"),
        ((*NAMED, "--fault", "unplugged:s9"), "there is no sensor s9; the sensors are s1, s2, s3, s4"),
        ((*NAMED, "--fault", "unplugged"), "give one sensor, as in unplugged:s1"),
        ((*NAMED, "--fault", "swapped:s1,s1"), "give two sensors, as in swapped:s1,s2"),
        ((*NAMED, "--fault", "lost:101"), "give a percentage up to 100, as in lost:10"),
        ((*NAMED, "--fault", "late:nan"), "give a delay in ms up to 60000, as in late:80"),
        ((*NAMED, "--fault", "pause:3"), "give times instead, as in pause@10..12"),
        ((*NAMED, "--fault", "stuck:s1@5..4"), "after @ give the seconds from which and until which it is on"),
    ],
)
def test_wrong_arguments_are_one_line_and_exit_2(
    rig_here: Command,
    bench_model: Path,
    tmp_path: Path,
    options: tuple[str, ...],
    said: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("taken").write_text("keep me")
    done = rig_here(SCENE, "--model", bench_model, *options)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert done.stderr.startswith("beamtouch-rig: ")
    assert said in done.stderr
    assert Path("taken").read_text() == "keep me"


@pytest.mark.parametrize(
    ("option", "text", "said"),
    [
        ("--script", "[[step]]\nseconds = 0", "seconds"),
        ("--script", "[[step]]\nseconds = 1\nposition_mm = 3", "together"),
        ("--script", "[[step]]\nseconds = 1\nposition_mm = 401\nforce_n = 1", "must lie on the beam"),
        ("--script", "[[step]]\nseconds = 1\nspeed = 3", "speed"),
        *(("--script", f"repeat = {one}\n[[step]]\nseconds = 1", "repeat") for one in ('"yes"', "1")),
        ("--imperfections", "gain = [1.0]", "gain has 1 entries for 4 channels"),
        ("--imperfections", "gian = [1, 1, 1, 1]", "unknown key gian"),
        ("--imperfections", "fixity = [1.0, 0.0]", "fixity"),
        ("--imperfections", "position_offset_mm = [-200, 0, 0, 0]", "moves a sensor off the beam"),
    ],
)
def test_a_wrong_file_is_one_line(
    rig_here: Command, bench_model: Path, tmp_path: Path, option: str, text: str, said: str
) -> None:
    path = tmp_path / "file.toml"
    path.write_text(text)
    done = rig_here(SCENE, "--model", bench_model, *TCP, option, path)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert said in done.stderr


ASK = struct.pack(">HHBBHH", 0, 6, 1, 4, 0, 4)
LONG = 17
"""Bytes of an answer with four counts: two answers may come together."""


class Rig:
    """A rig on Modbus TCP that takes loads and faults from a test."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        assert process.stdout is not None
        self.process, self._out, self._number = process, process.stdout, 0
        self.port = int(self._out.readline().rpartition(":")[2])
        self.line = socket.create_connection(("127.0.0.1", self.port), 60)

    def type(self, line: str) -> str:
        """Type a line; returns what the rig says of it."""
        assert self.process.stdin is not None
        self.process.stdin.write(f"{line}\n")
        self.process.stdin.flush()
        return self._out.readline()

    def ask(self) -> int:
        """Send a request; returns its number."""
        self._number += 1
        self.line.sendall(struct.pack(">H", self._number) + ASK)
        return self._number

    def answer(self) -> tuple[int, list[int]]:
        """Return the number and the counts of the next answer."""
        frame = self.line.recv(LONG, socket.MSG_WAITALL)
        return struct.unpack(">H", frame[:2])[0], list(struct.unpack(">4H", frame[9:]))

    def is_silent(self) -> bool:
        """Return whether no answer comes for a while."""
        self.line.settimeout(0.3)
        try:
            return not self.line.recv(100)
        except TimeoutError:
            return True
        finally:
            self.line.settimeout(60)

    def counts(self) -> list[int]:
        """Ask for the counts of all channels."""
        number = self.ask()
        answered, counts = self.answer()
        assert answered == number
        return counts


@pytest.fixture(scope="module")
def one_rig(bench_model: Path) -> Iterator[Rig]:
    """The rig of all tests that leave it as they found it; it has said nothing unasked when SIGTERM ends it."""
    with process_of(SCENE, "--model", bench_model, *TCP, "--by-hand", "--no-ringing") as process:
        one = Rig(process)
        yield one
        one.line.close()
        process.terminate()
        _, said = process.communicate(timeout=60)
        assert (process.returncode, said) == (0, "")


@pytest.fixture
def rig(one_rig: Rig) -> Rig:
    """The rig without a fault or a load, also after a test that failed."""
    one_rig.type("mend")
    one_rig.type("")
    return one_rig


def near(counts: list[int], expected: list[int]) -> list[bool]:
    return [abs(one - other) < 10 * SIGMA_COUNTS for one, other in zip(counts, expected, strict=True)]


@pytest.mark.promise("docs/reference/rig.md", "type a fault to begin it, and `mend` to end all of them")
def test_faults_of_sensors_change_their_counts_until_they_are_mended(rig: Rig) -> None:
    assert rig.type("90 10") == "10 N at 90 mm is on\n"
    s1, s2, s3, s4 = before = rig.counts()
    assert not near([s1], [s3])[0]
    assert rig.type("swapped:s1,s3") == "swapped:s1,s3 is on\n"
    assert all(near(rig.counts(), [s3, s2, s1, s4]))
    rig.type("unplugged:s2")
    assert rig.counts()[1] == 0
    assert rig.type("mend") == "no fault is on\n"
    assert all(near(rig.counts(), before))
    rig.type("inverted:s4")
    assert all(near(rig.counts(), [s1, s2, s3, 65535 - s4]))
    rig.type("stuck:s1")
    held = rig.counts()[0]
    assert rig.type("") == "nothing is on\n"
    assert rig.counts()[0] == held
    assert near([held], [s1])[0]
    rig.type("mend")
    assert not near(rig.counts()[:1], [s1])[0]


@pytest.mark.promise(
    "docs/reference/rig.md",
    "the device does nothing, and answers the requests that wait when the pause ends",
)
def test_replies_are_late_or_lost_or_wait_and_keep_their_numbers(rig: Rig) -> None:
    rig.type("late:300")
    began_s = time.monotonic()
    numbers = [rig.ask(), rig.ask()]
    assert [rig.answer()[0], rig.answer()[0]] == numbers
    assert time.monotonic() - began_s >= 0.3
    rig.type("mend")
    rig.type("lost:100")
    rig.ask()
    assert rig.is_silent()
    rig.type("mend")
    rig.type("pause")
    number = rig.ask()
    assert rig.is_silent()
    rig.type("mend")
    assert rig.answer()[0] == number  # when the pause ends; the request before it is lost


def test_clients_that_go_before_their_answer_leave_no_word(rig: Rig) -> None:
    """The fixture looks at what the rig has said."""
    for _ in range(50):
        with socket.create_connection(("127.0.0.1", rig.port), 60) as client:
            client.sendall(struct.pack(">H", 1) + ASK)
    assert len(rig.counts()) == 4


def test_a_port_that_is_taken_is_named(rig: Rig, rig_here: Command, bench_model: Path) -> None:
    where = f"127.0.0.1:{rig.port}"
    done = rig_here(SCENE, "--model", bench_model, "--modbus-tcp", where)
    said = f"beamtouch-rig: cannot listen on {where}: in use; stop the program that listens there"
    assert (done.returncode, done.stdout, done.stderr[: len(said)]) == (2, "", said)


@pytest.mark.parametrize(
    ("board", "said"),
    [("absent", "absent: No such file or directory"), ("/bin/false", "the simulated board /bin/false did not start")],
)
def test_a_board_that_does_not_start_is_named(
    rig_here: Command, ten_bits: tuple[Path, Path], tmp_path: Path, board: str, said: str
) -> None:
    scene, model = ten_bits
    done = rig_here(scene, "--model", model, "--serial", tmp_path / "line", "--firmware", board, "firmware.elf")
    assert (done.returncode, done.stdout, done.stderr) == (2, "", f"beamtouch-rig: {said}\n")


def test_a_board_that_ends_is_reported_and_ends_the_rig(
    board: Board, ten_bits: tuple[Path, Path], tmp_path: Path
) -> None:
    (scene, model), line = ten_bits, tmp_path / "line"
    with process_of(scene, "--model", model, "--serial", line, "--firmware", *board.command) as rig:
        assert rig.stdout
        assert rig.stdout.readline() == f"listening on serial {line}\n"
        (child,) = Path(f"/proc/{rig.pid}/task/{rig.pid}/children").read_text().split()
        os.kill(int(child), signal.SIGKILL)
        _, said = rig.communicate(timeout=60)
    assert (rig.returncode, said) == (2, "beamtouch-rig: the simulated board ended unexpectedly\n")
