"""Devices on a serial line that are there and do not answer, and lines that nobody reads."""

import pytest

from beamtouch_daemon.config.sources import SerialLine
from beamtouch_daemon.sources.board import BoardPort, BoardSource
from beamtouch_daemon.sources.reading import SourceError, first_readings
from beamtouch_protocol.messages import HelloRequest, Message, Pong

from .devices import SerialDevice
from .lines import terminal

pytestmark = pytest.mark.anyio


class WithoutClock(SerialDevice):
    """A device that answers no ping."""

    def send(self, message: Message) -> None:
        if not isinstance(message, Pong):
            super().send(message)


def send_many(opened: BoardPort) -> None:
    """Send more than any driver keeps."""
    for _ in range(100_000):
        opened.tell(HelloRequest())


async def test_a_device_that_answers_no_ping_gives_no_readings_of_unknown_age(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("beamtouch_daemon.sources.board.HELLO_TIMEOUT_S", 0.4)
    with terminal() as line:
        WithoutClock(line)
        settings = SerialLine(kind="serial", port=line.path)
        with pytest.raises(SourceError, match=r"no answer to a ping within 0\.4 s, so the age of its readings is"):
            await first_readings(BoardSource(settings, [0], 200.0, adc_bits=[16]), 1)


async def test_a_line_that_nobody_reads_is_an_error_once_its_buffer_is_full() -> None:
    with terminal() as line:
        opened = BoardPort(line.path, 115_200)
        try:
            with pytest.raises(SourceError, match=rf"{line.path} accepts no data: its buffer is full"):
                send_many(opened)
        finally:
            opened.close()
