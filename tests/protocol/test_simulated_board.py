"""The simulated board in real time: a serial port that a host opens, and voltages that change while it runs."""

import os
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from beamtouch_protocol.framing import Decoder, encode
from beamtouch_protocol.messages import Hello, HelloRequest, Message, Reading, Start
from simulated_board import Board, count_of

LIVE_TIMEOUT_S = 60.0


@contextmanager
def live(board: Board, link: Path) -> Iterator[subprocess.Popen[str]]:
    """The board in real time, on a pseudo-terminal at `link`."""
    with subprocess.Popen(
        [*board.command, "--link", str(link)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout
        try:
            assert process.stdout.readline() == f"serial {link}\n"
            yield process
        finally:
            process.kill()


class Line:
    """A host's end of the line."""

    def __init__(self, path: Path) -> None:
        self._descriptor = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        self._decoder = Decoder()

    def send(self, message: Message) -> None:
        os.write(self._descriptor, encode(message))

    def wait_for(self, is_it: Callable[[Message], bool]) -> None:
        """Read until a message satisfies `is_it`."""
        end = time.monotonic() + LIVE_TIMEOUT_S
        while time.monotonic() < end:
            try:
                data = os.read(self._descriptor, 4096)
            except BlockingIOError:
                time.sleep(0.01)
                continue
            if any(map(is_it, self._decoder.feed(data))):
                return
        pytest.fail("the message did not arrive")

    def close(self) -> None:
        os.close(self._descriptor)


def is_compatible_hello(message: Message) -> bool:
    return isinstance(message, Hello) and message.is_compatible


def reading_of(count: int) -> Callable[[Message], bool]:
    def is_it(message: Message) -> bool:
        return isinstance(message, Reading) and message.counts[0] == count

    return is_it


def test_a_host_opens_the_board_as_a_serial_port(board: Board, tmp_path: Path) -> None:
    link = tmp_path / "device"
    with live(board, link) as process:
        assert process.stdin
        line = Line(link)
        line.send(HelloRequest())
        line.wait_for(is_compatible_hello)
        line.send(Start(100, 1))
        for millivolts in (1000, 4000):
            process.stdin.write(f"{millivolts}\n")
            process.stdin.flush()
            line.wait_for(reading_of(count_of(millivolts)))
        line.close()
        process.stdin.close()
        assert process.wait(LIVE_TIMEOUT_S) == 0
    assert not link.is_symlink()


def test_sigterm_ends_the_board_and_removes_its_link(board: Board, tmp_path: Path) -> None:
    with live(board, tmp_path / "device") as process:
        process.terminate()
        assert process.wait(LIVE_TIMEOUT_S) == 0
    assert not (tmp_path / "device").is_symlink()
