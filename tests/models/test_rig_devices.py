"""The rig's devices in this process: the serial device on a clock whose time is known, and what a board is given."""

import asyncio
import math
import os
import socket
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from beamtouch_models.errors import SceneError
from beamtouch_models.lab.rig import devices
from beamtouch_models.lab.rig.devices import Module, SerialDevice, rtu_server, start_board, tcp_server
from beamtouch_models.lab.rig.faults import Faults
from beamtouch_models.lab.rig.lines import Relay, joined_line, named_line, read, write
from beamtouch_protocol.framing import Decoder, encode
from beamtouch_protocol.messages import Hello, HelloRequest, Message, Ping, Pong, Reading, Start

BITS = 12


class Line:
    """A device on one end of a line, whose clock moves only when it converts or sleeps; a host on the other."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, *takes_s: float) -> None:
        """Each conversion takes the next of these times, and the last one ever after."""
        self.now_s, self.slept_s = 50.0, list[float]()
        self._takes_s, self._conversions, self._decoder = list(takes_s), 0, Decoder()
        monkeypatch.setattr(devices, "time", SimpleNamespace(monotonic=lambda: self.now_s))
        monkeypatch.setattr(devices, "asyncio", SimpleNamespace(**vars(asyncio) | {"sleep": self._sleep}))
        self.host, self._end = socket.socketpair()
        for end in (self.host, self._end):
            end.setblocking(False)
        self.device = SerialDevice(self._end.fileno(), self._convert, 3, BITS, Relay(Faults(["s1"]), lambda: 0.0))

    async def _sleep(self, seconds: float) -> None:
        self.slept_s.append(seconds)
        self.now_s += seconds
        await asyncio.sleep(0)

    def _convert(self) -> list[int]:
        self.now_s += self._takes_s.pop(0) if len(self._takes_s) > 1 else self._takes_s[0]
        self._conversions += 1
        return [self._conversions, 100, 10 * self._conversions]

    @asynccontextmanager
    async def served(self) -> AsyncIterator[None]:
        serving = asyncio.create_task(self.device.serve())
        try:
            yield
        finally:
            serving.cancel()
            with suppress(asyncio.CancelledError):
                await serving
            assert not asyncio.get_running_loop().remove_reader(self._end)  # it no longer listens
            self.host.close()
            self._end.close()

    async def received(self, count: int, *sent: Message) -> list[Message]:
        """Send messages, and return so many of the device."""
        loop, messages = asyncio.get_running_loop(), list[Message]()
        await loop.sock_sendall(self.host, b"".join(map(encode, sent)))
        while len(messages) < count:
            messages += self._decoder.feed(await loop.sock_recv(self.host, 64))
        return messages


def streamed(line: Line, start: Start, count: int, after_s: float = 0.0) -> list[Reading]:
    async def stream() -> list[Message]:
        async with line.served():
            await line.received(1)
            line.now_s += after_s
            return await line.received(count, start)

    messages = asyncio.run(asyncio.wait_for(stream(), 60))[:count]
    readings = [one for one in messages if isinstance(one, Reading)]
    assert len(readings) == count
    return readings


def test_readings_come_in_slots_of_the_rate_and_those_that_are_missed_have_numbers_too(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """At 500 Hz: the second conversion takes 12.3 ms, so that five slots are missed and the next reading is late."""
    line = Line(monkeypatch, 0.0003, 0.0123, 0.0003)
    readings = streamed(line, Start(500, 1), 5, after_s=4294.9672)
    assert [one.sequence for one in readings] == [0, 1, 7, 8, 9]
    assert line.slept_s[:4] == pytest.approx([0.0017, 0.0, 0.0014, 0.0017], abs=1e-9)
    # The clock of the device began with it, and starts anew after 2^32 us.
    since_us = [4_294_967_200, 4_294_969_200, 4_294_981_500, 4_294_983_200, 4_294_985_200]
    assert [one.device_us for one in readings] == [us % 2**32 for us in since_us]
    assert [one.counts for one in readings] == [(number, 100, 10 * number) for number in (1, 2, 3, 4, 5)]


def test_numbers_start_anew_after_65535(monkeypatch: pytest.MonkeyPatch) -> None:
    line = Line(monkeypatch, 65530 / 500 + 0.0001, 0.0001)
    assert [one.sequence for one in streamed(line, Start(500, 1), 8)] == [0, *range(65530, 65536), 0]


def test_a_reading_is_the_sum_of_as_many_conversions_as_are_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    first, second = streamed(Line(monkeypatch, 1e-5), Start(2000, 16), 2)
    assert (first.oversampling, first.counts) == (16, (136, 1600, 1360))  # 1 + ... + 16
    assert second.counts == (392, 1600, 3920)


def test_a_device_says_what_it_is_and_takes_rates_and_sums_that_its_counts_leave_room_for(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Sixteen times 4095 is 65520."""
    line = Line(monkeypatch, 1e-5)

    async def ask() -> list[Message]:
        async with line.served():
            refused = Start(2001, 1), Start(0, 1), Start(500, 17), Start(500, 0)
            return await line.received(3, *refused, HelloRequest(), Ping(7))

    first, again, pong = asyncio.run(asyncio.wait_for(ask(), 60))
    assert isinstance(first, Hello)
    assert (first.channel_count, first.adc_bits, first.max_rate_hz, first.is_compatible) == (3, 12, 2000, True)
    assert again == first
    assert pong == Pong(7, 0)


def test_requests_for_another_unit_are_answered_on_tcp_and_not_on_a_serial_line() -> None:
    async def made() -> list[bool]:
        tcp = tcp_server(lambda: [0], 1, Module(), "127.0.0.1", 0)
        return [server.ignore_missing_devices for server in (tcp, rtu_server(lambda: [0], 1, Module(), "line"))]

    assert asyncio.run(made()) == [False, True]


def open_files() -> int:
    return len(list(Path("/proc/self/fd").iterdir()))


def test_a_named_line_is_there_for_as_long_as_it_is_used(tmp_path: Path) -> None:
    path, before = tmp_path / "line", open_files()
    with named_line(path) as end:
        assert path.is_char_device()
        host = os.open(path, os.O_RDWR | os.O_NOCTTY)
        os.write(host, b"\0\x03\n\r")  # as it is, without echo or line ends
        assert read(end) == b"\0\x03\n\r"
        assert read(end) == b""
        write(end, b"\n\x04")
        assert os.read(host, 10) == b"\n\x04"
        os.close(host)
        with (
            pytest.raises(SceneError, match="exists already; choose another path or remove the file"),
            named_line(path),
        ):
            pass
    assert not path.is_symlink()
    assert open_files() == before
    with (
        pytest.raises(SceneError, match="absent/line: No such file or directory"),
        named_line(tmp_path / "absent/line"),
    ):
        pass
    assert open_files() == before


def test_what_is_sent_on_a_joined_line_passes_the_relay_both_ways(tmp_path: Path) -> None:
    path, before = tmp_path / "line", open_files()

    async def exchange() -> list[bytes]:
        faults, replied, loop = Faults(["s1"]), asyncio.Event(), asyncio.get_running_loop()

        def clock() -> float:
            replied.set()
            return 0.0

        async def come(end: int) -> bytes:
            came = asyncio.Event()
            loop.add_reader(end, came.set)
            await came.wait()
            loop.remove_reader(end)
            return read(end)

        add, listened = loop.add_reader, list[int]()

        def listen(end: int, *given: Any) -> None:  # noqa: ANN401
            listened.append(end)
            add(end, *given)

        loop.add_reader = listen  # type: ignore[method-assign, assignment]
        with joined_line(path, Relay(faults, clock)) as near:
            device, host = (os.open(name, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK) for name in (near, str(path)))
            os.write(host, b"ask")
            passed = [await come(device)]
            os.write(device, b"answer")
            passed.append(await come(host))
            faults.add("lost:100", 0.0)
            replied.clear()
            os.write(device, b"lost")
            await replied.wait()
            faults.mend()
            os.write(device, b"later")
            passed.append(await come(host))
            os.close(device)
            os.close(host)
        assert len(listened) == 5
        assert not any(map(loop.remove_reader, listened))
        return passed

    assert asyncio.run(asyncio.wait_for(exchange(), 60)) == [b"ask", b"answer", b"later"]
    assert not path.is_symlink()
    assert open_files() == before


OUTPUTS = [0.0, 0.1234, 0.25, 0.51, 0.77777, 0.9993, 0.9996, 1.0]


def test_a_board_is_started_with_its_image_and_line_and_given_millivolts_that_its_adc_rounds_down(
    tmp_path: Path,
) -> None:
    board, told = tmp_path / "board", tmp_path / "told"
    board.write_text(f'#!/bin/sh\necho "$@" > {told}\necho ready\nhead -n 1 >> {told}\n')
    board.chmod(0o755)
    line = tmp_path / "line"
    line.symlink_to(tmp_path / "gone")

    async def run() -> None:
        await (await start_board(board, tmp_path / "firmware.elf", line, lambda: OUTPUTS))

    with pytest.raises(SceneError, match="the simulated board ended unexpectedly"):
        asyncio.run(asyncio.wait_for(run(), 60))
    arguments, given = told.read_text().splitlines()
    assert arguments == f"{tmp_path / 'firmware.elf'} --link {line}"
    assert not line.is_symlink()
    millivolts = [int(word) for word in given.split()]
    assert [math.floor(value * 1023 / 5000) for value in millivolts] == [round(output * 1023) for output in OUTPUTS]
    assert (millivolts[0], millivolts[-1]) == (2, 5000)
