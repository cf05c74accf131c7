"""A serial port that takes no data: an error at once."""

import pytest

from beamtouch_daemon.sources.board import BoardLine
from beamtouch_daemon.sources.reading import SourceError
from beamtouch_daemon.sources.serial_port import LineSettings, Opener, SerialPort
from beamtouch_protocol.messages import HelloRequest

from .lines import terminal

pytestmark = pytest.mark.anyio


async def test_a_port_that_was_unplugged_is_gone_before_the_event_loop_notices() -> None:
    with terminal() as line:
        port = await opened(line.path)
        line.unplug()
        with pytest.raises(SourceError, match=f"{line.path} is gone or accepts no data"):
            port.send(b"\x01")


async def test_a_port_whose_buffer_is_full_accepts_no_data() -> None:
    with terminal() as line:
        port = await opened(line.path)
        with pytest.raises(SourceError, match=f"{line.path} accepts no data: its buffer is full"):
            send_many(BoardLine(port))
        port.close()


async def test_only_a_port_that_failed_lowers_dtr_at_its_end_which_resets_the_device() -> None:
    with terminal() as line:
        for failure in ("", "silent", ""):
            (await opened(line.path)).close(failure)
            assert line.lowers_dtr == bool(failure)


async def opened(path: str) -> SerialPort:
    return await Opener(path, LineSettings(115_200)).open()


def send_many(line: BoardLine) -> None:
    """Send more than any driver keeps."""
    for _ in range(100_000):
        line.send(HelloRequest())
