"""An open serial port: how much is read at a time, why it is closed, and how long it stays open."""

import asyncio
import os
import socket
from typing import cast

import pytest
import serial

from beamtouch_common.uptime import uptime_s
from beamtouch_daemon.sources import kept_port
from beamtouch_daemon.sources.converter import Converter, connect
from beamtouch_daemon.sources.host_address import HostAddress
from beamtouch_daemon.sources.kept_port import KeptPort
from beamtouch_daemon.sources.reading import SourceError
from beamtouch_daemon.sources.serial_port import LineSettings, Opener, SerialPort
from support.network.free_ports import free_port

from .lines import terminal

pytestmark = pytest.mark.anyio

LINE = LineSettings(115_200)


class Device:
    """A device whose driver holds this many bytes for each read; then no more."""

    is_open = True

    def __init__(self, *sizes: int) -> None:
        self.asked = list[int]()
        self._left = list(sizes)

    def read(self, most: int) -> bytes:
        self.asked.append(most)
        return b"x" * min(self._left.pop(0), most) if self._left else b""


@pytest.mark.parametrize(
    ("sizes", "reads"),
    [((), 1), ((100, 100), 1), ((2047, 100), 1), ((2048, 100), 2), ((4096, 4096, 5, 5), 3), ((4096,) * 100, 64)],
)
def test_a_port_is_read_until_little_comes_and_64_times_4096_bytes_at_most(sizes: tuple[int, ...], reads: int) -> None:
    device = Device(*sizes)
    port = SerialPort("/dev/x", cast(serial.Serial, device))
    before_s = uptime_s()
    assert len(port.take()) == sum(sizes[:reads])
    assert device.asked == [4096] * reads
    assert before_s <= port.taken_s <= uptime_s()


@pytest.mark.parametrize(
    ("path", "said"),
    [
        ("/dev/ttyNONE", "(No such file or directory); plug the device in or correct the path"),
        ("/dev/null", "(Inappropriate ioctl for device); correct the path"),
    ],
)
async def test_a_port_that_cannot_be_opened_is_said_with_what_to_do(path: str, said: str) -> None:
    with pytest.raises(SourceError) as raised:
        await Opener(path, LINE).open()
    assert str(raised.value) == f"{path} cannot be opened {said}"


async def test_a_port_is_used_by_one_program_at_a_time() -> None:
    with terminal() as line:
        port = await Opener(line.path, LINE).open()
        with pytest.raises(SourceError) as raised:
            await Opener(line.path, LINE).open()
        port.close()
        words = "(Resource temporarily unavailable); another program uses it: stop that one"
        assert str(raised.value) == f"{line.path} cannot be opened {words}"


async def test_settings_that_are_refused_leave_those_before() -> None:
    with terminal() as line:
        port = await Opener(line.path, LINE).open()
        port.traffic.note_other(b"x")
        with pytest.raises(SourceError) as raised:
            port.change(LineSettings(9600, "even"))
        assert str(raised.value) == f"{line.path} refuses these settings: Invalid argument"
        assert port.traffic.noise == ""
        port.change(LineSettings(9600))
        port.close()


async def test_a_closed_port_gives_the_first_reason_and_no_bytes() -> None:
    with terminal() as line:
        port = await Opener(line.path, LINE).open()
        port.close("it was silent")
        port.close("it is gone")
        assert port.take() == b""
        with pytest.raises(SourceError, match=r"^it was silent$"):
            await port.receive(60.0)
        other = await Opener(line.path, LINE).open()
        assert await other.receive(0.001) == b""
        other.close()
        with pytest.raises(SourceError, match=f"^{line.path} is closed$"):
            await other.receive(60.0)


async def test_a_port_stays_open_as_long_as_somebody_uses_it_or_wants_it_kept() -> None:
    with terminal() as line:
        kept = KeptPort(line.path, LINE)
        async with kept.used() as first:
            async with kept.used() as second:
                assert second is first
            assert first.failure == ""
        assert first.failure == f"{line.path} is closed"
        with kept.kept_open():
            async with kept.used() as third:
                assert third is not first
            async with kept.used() as fourth:
                assert fourth is third
            fourth.close("it is gone")
            async with kept.used() as fifth:
                assert fifth is not fourth
        assert fifth.failure == f"{line.path} is closed"


async def test_a_port_without_a_frame_for_half_a_minute_is_opened_again_by_the_next_session(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with terminal() as line:
        kept = KeptPort(line.path, LINE)
        with kept.kept_open():
            async with kept.used() as first:
                pass
            monkeypatch.setattr(kept_port, "uptime_s", lambda: uptime_s() + 15.0)
            async with kept.used() as second:
                assert second is first
            monkeypatch.setattr(kept_port, "uptime_s", lambda: uptime_s() + 30.0)
            async with kept.used() as second:
                assert first.failure == f"{line.path} was silent for 30 s and is opened again"
                assert second.failure == ""


@pytest.mark.parametrize("host", ["127.0.0.1", "::1"])
async def test_no_call_of_a_connection_to_a_converter_waits(host: str) -> None:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    with socket.create_server((host, 0), family=family) as server:
        connection = await connect(HostAddress(host, server.getsockname()[1]))
        assert not os.get_blocking(connection.fileno())
        assert (connection.read(10), connection.is_open) == (b"", True)
        device, _ = server.accept()
        with device:
            assert connection.write(b"abc") == 3
            assert device.recv(10) == b"abc"
            device.sendall(b"defgh")
            await readable(connection)
            assert (connection.read(3), connection.read(10)) == (b"def", b"gh")
            while connection.write(bytes(1_000_000)):
                pass  # until the buffers are full
        await readable(connection)
        with pytest.raises(OSError, match=r"it has closed the connection|Connection reset"):
            connection.read(10)
        connection.close()
        assert not connection.is_open


async def readable(connection: Converter) -> None:
    """Wait until there is something to read, or the connection has ended."""
    arrived, loop = asyncio.Event(), asyncio.get_running_loop()
    loop.add_reader(connection.fileno(), arrived.set)
    await asyncio.wait_for(arrived.wait(), 60)
    loop.remove_reader(connection.fileno())


async def test_a_converter_that_is_not_there_is_said() -> None:
    port = free_port()
    with pytest.raises(SourceError, match=f"^no connection to 127.0.0.1:{port}; is the device on, and is the address"):
        await connect(HostAddress("127.0.0.1", port))
