"""The rig on a serial line, and the host at its other end."""

import contextlib
import os
import re
import select
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from beamtouch_protocol.framing import Decoder, encode
from beamtouch_protocol.messages import Hello, HelloRequest, Message, Ping, Pong, Reading, Start, Stop
from models.rig_process import process_of
from support.running.waiting import wait_until
from support.surfaces.example_scenes import SCENES

SCENE = SCENES / "bench.toml"


class SerialRig:
    """A rig on a serial line, by hand, and the host at the other end."""

    def __init__(self, process: subprocess.Popen[str], line: Path) -> None:
        assert process.stdin is not None
        assert process.stdout is not None
        assert process.stderr is not None
        self._in, self._out, self._said = process.stdin, process.stdout, process.stderr
        assert self._out.readline() == f"listening on serial {line}\n"
        self._host, self._decoder = os.open(line, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK), Decoder()
        (self.hello,) = self.until(bool)

    def type(self, *lines: str) -> tuple[str, list[str]]:
        """Type lines, of which the last one is right; returns what the rig says of it, and of the others."""
        os.write(self._in.fileno(), "".join(f"{line}\n" for line in lines).encode("latin-1"))
        return self._out.readline(), [self._said.readline() for _ in lines[1:]]

    def send(self, *messages: Message) -> None:
        """Send messages to the device, as fast as it takes them."""
        data = b"".join(map(encode, messages))
        while data:
            with contextlib.suppress(BlockingIOError):
                data = data[os.write(self._host, data) :]

    def until(self, holds: Callable[[list[Message]], bool], within_s: float = 60.0) -> list[Message]:
        """Return the messages of the device up to a condition."""
        received: list[Message] = []

        def enough() -> bool:
            with contextlib.suppress(BlockingIOError):
                received.extend(self._decoder.feed(os.read(self._host, 4096)))
            return holds(received)

        wait_until(enough, within_s, 0.001)
        return received

    def is_silent(self) -> bool:
        """Drop what the device has sent, and return whether it sends nothing more for a while."""
        with contextlib.suppress(BlockingIOError):
            self._decoder.feed(os.read(self._host, 4096))
        readable, _, _ = select.select([self._host], [], [], 0.3)
        return not readable

    def close(self) -> None:
        os.close(self._host)


@pytest.fixture(scope="module")
def one_serial_rig(bench_model: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[SerialRig]:
    """The rig of the tests of a serial line; it has said nothing unasked when SIGTERM ends it."""
    line = tmp_path_factory.mktemp("serial") / "line"
    with process_of(SCENE, "--model", bench_model, "--serial", line, "--by-hand") as process:
        one = SerialRig(process, line)
        yield one
        one.close()
        process.terminate()
        _, said = process.communicate(timeout=60)
        assert (process.returncode, said) == (0, "")


@pytest.fixture
def serial_rig(one_serial_rig: SerialRig) -> SerialRig:
    """The rig without a fault or a load, with nothing left to send, also after a test that failed."""
    one_serial_rig.type("mend")
    one_serial_rig.type("")
    one_serial_rig.send(Stop())
    wait_until(one_serial_rig.is_silent)
    return one_serial_rig


def test_lines_that_are_no_load_are_named(serial_rig: SerialRig) -> None:
    told, lines = serial_rig.type("abc", "9999 10", "150\xa0mm 10", "stuck:s1@2..", "150 12")
    assert told == "12 N at 150 mm is on\n"
    usage = r"beamtouch-rig: give a position in mm and a force in N, as in 150 10"
    for text, expected in zip(
        lines, (usage, r".* 10 N at 9999 mm is no load on a beam of 400 mm", usage, r".* leave out @"), strict=True
    ):
        assert re.match(expected, text), text


def tokens(messages: list[Message]) -> list[int]:
    return [one.token for one in messages if isinstance(one, Pong)]


def readings_in(messages: list[Message]) -> list[Reading]:
    return [one for one in messages if isinstance(one, Reading)]


def test_a_rig_replaces_the_link_of_a_killed_one_counts_scans_from_0_and_removes_its_line_on_ctrl_c(
    bench_model: Path, tmp_path: Path
) -> None:
    line = tmp_path / "line"
    line.symlink_to(tmp_path / "gone")
    with process_of(SCENE, "--model", bench_model, "--serial", line, "--by-hand") as process:
        rig = SerialRig(process, line)
        rig.send(Start(100, 1))
        first, *_ = rig.until(bool)
        assert isinstance(first, Reading)
        assert first.sequence == 0
        rig.close()
        process.send_signal(signal.SIGINT)
        _, said = process.communicate(timeout=60)
    assert (process.returncode, said) == (130, "")
    assert not line.is_symlink()


def test_the_serial_device_says_hello_streams_until_stopped_and_ignores_what_is_not_for_it(
    serial_rig: SerialRig,
) -> None:
    # Neither a pong, nor a rate or an oversampling that it does not have, is for a device.
    serial_rig.send(Pong(6, 0), Start(2001, 1), Start(500, 2), HelloRequest(), Ping(7), Start(500, 1))
    received = serial_rig.until(lambda so_far: len(readings_in(so_far)) >= 50)
    serial_rig.send(Stop(), Ping(8))
    received += serial_rig.until(lambda so_far: 8 in tokens(so_far))
    serial_rig.send(Ping(9))  # since the stop it has sent only answers
    last = serial_rig.until(lambda so_far: 9 in tokens(so_far))
    assert len(last) == 1
    again, pong, *streamed, before_last = received
    hello = serial_rig.hello
    assert isinstance(hello, Hello)
    assert again == hello
    assert (hello.channel_count, hello.adc_bits, hello.is_compatible) == (4, 16, True)
    assert tokens([pong, before_last]) == [7, 8]
    readings = readings_in(streamed)
    assert len(readings) == len(streamed)
    numbers = [reading.sequence for reading in readings]
    assert numbers == sorted(set(numbers))  # a scan that a busy machine skips has a number too
    assert all(len(reading.counts) == 4 for reading in readings)
    clocks = np.array([reading.device_us for reading in readings])
    # A busy machine skips slots and is late for others, but never catches up.
    assert (np.diff(clocks) > 0).all()
    assert clocks[-1] - clocks[0] >= (len(readings) - 3) * 2000


def test_frames_of_the_serial_protocol_are_lost(serial_rig: SerialRig) -> None:
    serial_rig.type("lost:20")
    serial_rig.send(Start(400, 1))
    readings = readings_in(serial_rig.until(lambda so_far: len(readings_in(so_far)) >= 150))
    sent = readings[-1].sequence - readings[0].sequence + 1
    assert 1 - len(readings) / sent > 0.05  # 20 % by the fault, and more on a busy machine
    serial_rig.type("mend")
    serial_rig.send(Stop(), Ping(1))
    serial_rig.until(lambda so_far: 1 in tokens(so_far))


def test_a_pause_stops_the_readings_and_the_answers_of_the_serial_device(serial_rig: SerialRig) -> None:
    serial_rig.send(Start(400, 1))
    before = readings_in(serial_rig.until(lambda so_far: bool(readings_in(so_far))))
    serial_rig.type("pause")
    serial_rig.send(Ping(2))
    wait_until(serial_rig.is_silent)  # after what was under way
    serial_rig.type("mend")
    received = serial_rig.until(lambda so_far: bool(readings_in(so_far)) and 2 in tokens(so_far))
    assert readings_in(received)[0].device_us - before[-1].device_us > 90_000
    serial_rig.send(Stop(), Ping(3))
    serial_rig.until(lambda so_far: 3 in tokens(so_far))


def answered_or_late(by_s: float) -> Callable[[list[Message]], bool]:
    return lambda so_far: bool(tokens(so_far)) or time.monotonic() > by_s


def test_frames_on_a_line_that_nobody_reads_are_lost_and_the_device_goes_on(serial_rig: SerialRig) -> None:
    requests = 6000  # their answers are more than a pseudo-terminal holds
    serial_rig.send(*[HelloRequest()] * requests)
    # What was lost may have ended in the middle of a frame.
    pings = iter(range(10, 1000))
    received: list[Message] = []
    while not tokens(received):
        serial_rig.send(Ping(next(pings)))
        received += serial_rig.until(answered_or_late(time.monotonic() + 1.0))  # this one may be lost, too
    assert len(received) < requests
