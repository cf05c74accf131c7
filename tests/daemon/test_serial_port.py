"""A serial port that goes away, for those who send and for those who wait."""

import asyncio

import pytest

from beamtouch_daemon.sources.reading import SourceError
from beamtouch_daemon.sources.serial_port import SerialPort

from .lines import terminal

pytestmark = pytest.mark.anyio

BAUD = 115_200


async def test_a_frame_for_a_port_that_was_just_unplugged_is_refused() -> None:
    with terminal() as line:
        port = SerialPort(line.path, BAUD)
        line.unplug()  # the event loop has no turn in which it could notice
        with pytest.raises(SourceError, match=f"{line.path} is gone or accepts no data"):
            port.send(b"\x01\x04\x00\x00\x00\x01\x31\xca")
        with pytest.raises(SourceError, match=line.path):  # there is no such port any more
            SerialPort(line.path, BAUD)


async def test_who_waits_for_bytes_learns_that_the_port_is_gone() -> None:
    with terminal() as line:
        port = SerialPort(line.path, BAUD)
        waits = asyncio.create_task(port.receive(60.0))
        await asyncio.sleep(0)  # it now waits
        line.unplug()
        with pytest.raises(SourceError, match=f"{line.path} is gone"):
            await waits


async def test_without_bytes_the_wait_ends_in_time() -> None:
    with terminal() as line:
        port = SerialPort(line.path, BAUD)
        assert await port.receive(0.01) == []
        port.close()
