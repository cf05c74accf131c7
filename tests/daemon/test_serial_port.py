"""A serial port that takes no data: an error at once."""

import pytest

from beamtouch_daemon.sources.board import BoardPort
from beamtouch_daemon.sources.reading import SourceError
from beamtouch_daemon.sources.serial_port import SerialPort
from beamtouch_protocol.messages import HelloRequest

from .lines import terminal

pytestmark = pytest.mark.anyio


async def test_a_port_that_was_unplugged_is_gone_before_the_event_loop_notices() -> None:
    with terminal() as line:
        port = SerialPort(line.path, 115_200)
        line.unplug()
        with pytest.raises(SourceError, match=f"{line.path} is gone or accepts no data"):
            port.send(b"\x01")


async def test_a_port_whose_buffer_is_full_accepts_no_data() -> None:
    with terminal() as line:
        opened = BoardPort(line.path, 115_200)
        with pytest.raises(SourceError, match=f"{line.path} accepts no data: its buffer is full"):
            send_many(opened)
        opened.close()


def send_many(opened: BoardPort) -> None:
    """Send more than any driver keeps."""
    for _ in range(100_000):
        opened.tell(HelloRequest())
