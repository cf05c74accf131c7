"""The faults that the rig plays: sensors, cables and replies, as a client of a module sees them."""

import os
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import pytest

from beamtouch_models.rig.faults import Faults
from beamtouch_protocol.framing import Decoder, encode
from beamtouch_protocol.messages import Message, Reading, Start
from example_scenes import SCENES
from in_process import Command

ASK = struct.pack(">HHBBHH", 0, 6, 1, 4, 0, 4)
SIGMA_COUNTS = 79
"""Noise of a reading of the bench, in counts."""


class Rig:
    """A rig on Modbus TCP that takes loads and faults from a test."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        assert process.stdout is not None
        self._process, self._out, self._number = process, process.stdout, 0
        self.line = socket.create_connection(("127.0.0.1", int(self._out.readline().rpartition(":")[2])), 60)

    def type(self, line: str) -> str:
        """Type a line; returns what the rig says of it."""
        assert self._process.stdin is not None
        self._process.stdin.write(f"{line}\n")
        self._process.stdin.flush()
        return self._out.readline()

    def ask(self) -> int:
        """Send a request; returns its number."""
        self._number += 1
        self.line.sendall(struct.pack(">H", self._number) + ASK)
        return self._number

    def answer(self) -> tuple[int, list[int]]:
        """Return the number and the counts of the next answer."""
        frame = self.line.recv(100)
        return struct.unpack(">H", frame[:2])[0], list(struct.unpack(">4H", frame[9:]))

    def counts(self) -> list[int]:
        """Ask for the counts of all channels."""
        number = self.ask()
        answered, counts = self.answer()
        assert answered == number
        return counts


@pytest.fixture
def rig(bench_model: Path) -> Iterator[Rig]:
    words = [SCENES / "bench.toml", "--model", bench_model, "--modbus-tcp", "127.0.0.1:0", "--by-hand", "--no-ringing"]
    program = [sys.executable, "-m", "beamtouch_models.rig.cli", *map(str, words)]
    with subprocess.Popen(program, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        try:
            one = Rig(process)
            yield one
            one.line.close()
        finally:
            process.terminate()


def near(counts: list[int], expected: list[int]) -> list[bool]:
    return [abs(one - other) < 10 * SIGMA_COUNTS for one, other in zip(counts, expected, strict=True)]


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
    rig.type("")  # lifted
    assert rig.counts()[0] == held
    assert near([held], [s1])[0]
    rig.type("mend")
    assert not near(rig.counts()[:1], [s1])[0]


def test_replies_are_late_or_lost_and_keep_their_numbers(rig: Rig) -> None:
    rig.type("late:300")
    began_s = time.monotonic()
    numbers = [rig.ask()]
    time.sleep(0.1)  # the second request comes while the first reply is still out
    numbers.append(rig.ask())
    assert [rig.answer()[0], rig.answer()[0]] == numbers
    assert time.monotonic() - began_s >= 0.4
    rig.type("mend")
    rig.type("lost:100")
    rig.ask()
    rig.line.settimeout(0.5)
    with pytest.raises(TimeoutError):
        rig.answer()
    rig.type("mend")
    rig.line.settimeout(60)
    assert len(rig.counts()) == 4


def test_a_paused_device_answers_when_the_pause_ends(rig: Rig) -> None:
    rig.type("pause")
    number = rig.ask()
    rig.line.settimeout(0.5)
    with pytest.raises(TimeoutError):
        rig.answer()
    rig.type("mend")
    rig.line.settimeout(60)
    assert rig.answer()[0] == number


def test_frames_of_the_serial_protocol_are_lost_and_a_pause_stops_them(bench_model: Path, tmp_path: Path) -> None:
    words = [SCENES / "bench.toml", "--model", bench_model, "--serial", tmp_path / "line"]
    program = [sys.executable, "-m", "beamtouch_models.rig.cli", *map(str, words)]
    faults = ["--fault", "lost:20", "--fault", "pause@0..0.1/0.2"]
    with subprocess.Popen([*program, *faults], stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            process.stdout.readline()
            host = os.open(tmp_path / "line", os.O_RDWR | os.O_NOCTTY)
            os.write(host, encode(Start(200, 1)))
            decoder, messages = Decoder(), list[Message]()
            while sum(isinstance(message, Reading) for message in messages) < 150:
                messages += decoder.feed(os.read(host, 4096))
            os.close(host)
        finally:
            process.terminate()
    readings = [message for message in messages if isinstance(message, Reading)]
    sent = readings[-1].sequence - readings[0].sequence + 1
    assert 1 - len(readings) / sent > 0.05  # 20 % by the fault, and more where the test is slow to read
    gaps_us = [later.device_us - one.device_us for one, later in pairwise(readings)]
    assert sum(gap > 90_000 for gap in gaps_us) >= 4


@pytest.mark.parametrize(
    ("times", "on", "off"),
    [
        ("", (0.0, 1e9), ()),
        ("@2..5", (2.0, 4.9), (1.9, 5.0, 1e9)),
        ("@2..", (2.0, 1e9), (1.9,)),
        ("@1..1.5/4", (1.0, 1.4, 5.2, 401.2), (0.9, 1.6, 4.9, 5.6, 403.0)),
    ],
)
def test_a_fault_comes_and_goes_at_its_times(times: str, on: tuple[float, ...], off: tuple[float, ...]) -> None:
    faults = Faults(["s1"], [f"pause{times}"])
    assert all(faults.pause_s(seconds) > 0 for seconds in on)
    assert not any(faults.pause_s(seconds) for seconds in off)


@pytest.mark.parametrize(
    ("fault", "said"),
    [
        ("foo", "fault foo: no such fault; give unplugged:s1, stuck:s1"),
        ("unplugged:s9", "there is no sensor s9; the sensors are s1, s2, s3, s4"),
        ("unplugged", "give one sensor, as in unplugged:s1"),
        ("swapped:s1,s1", "give two sensors, as in swapped:s1,s2"),
        ("lost:101", "give a percentage up to 100, as in lost:10"),
        ("late:nan", "give a delay in ms up to 60000, as in late:80"),
        ("pause:3", "give times instead, as in pause@10..12"),
        ("stuck:s1@5..4", "after @ give the seconds from which and until which it is on"),
        ("stuck:s1@0..1/0.5", "after @ give the seconds"),
        ("stuck:s1@x", "after @ give the seconds"),
    ],
)
def test_a_wrong_fault_is_one_line(rig_here: Command, bench_model: Path, tmp_path: Path, fault: str, said: str) -> None:
    line = ("--serial", tmp_path / "line")
    done = rig_here(SCENES / "bench.toml", "--model", bench_model, *line, "--fault", fault)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert f"beamtouch-rig: fault {fault}: " in done.stderr
    assert said in done.stderr


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--serial", "line", "--byte-order", "CDAB"), "--byte-order needs --modbus-tcp or --modbus-rtu"),
        (("--modbus-rtu", "line", "--type", "i16"), "counts up to 65535 do not fit --type i16"),
        (("--modbus-rtu", "line", "--register", "65533"), "--register 65533: 4 registers from there go beyond 65535"),
        (("--serial", "line", "--firmware", "b", "e", "--fault", "pause"), "only faults of sensors are played"),
    ],
)
def test_options_that_do_not_go_together_are_one_line(
    rig_here: Command, bench_model: Path, options: tuple[str, ...], said: str
) -> None:
    done = rig_here(SCENES / "bench.toml", "--model", bench_model, *options)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert said in done.stderr
