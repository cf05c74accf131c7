"""Readings that arrive in bursts, over a pseudo-terminal: none is stamped as newer than it is."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager

import pytest

from beamtouch_daemon.config.sources import SerialLine
from beamtouch_daemon.sources import board
from beamtouch_daemon.sources.board import BoardSource
from beamtouch_daemon.sources.reading import Reading, first_readings
from beamtouch_daemon.uptime import uptime_s
from beamtouch_protocol import messages
from beamtouch_protocol.messages import Message

from . import configs
from .devices import Pieces, SerialDevice, StampingUnit, rtu_units, tcp_unit
from .lines import Terminal, terminal
from .sessions import polled

pytestmark = pytest.mark.anyio

PATIENCE_S = 10.0
"""Silence that ends a session, in place of the daemon's 0.5 s: on a busy machine, a burst that was held back for 0.4 s
may arrive later than that."""
PIECE_BYTES = 62
"""Bytes of a serial line in one USB packet: a burst arrives in pieces of this size."""


class Adapter(Terminal):
    """A serial adapter that holds back what the device sends, and delivers it all at once."""

    def __init__(self) -> None:
        super().__init__()
        self._held = bytearray()

    def write(self, data: bytes) -> bool:
        self._held += data
        return True

    async def deliver_every(self, held_s: float) -> None:
        while True:
            await asyncio.sleep(held_s)
            held, self._held = bytes(self._held), bytearray()
            for start in range(0, len(held), PIECE_BYTES):
                super().write(held[start : start + PIECE_BYTES])
                await asyncio.sleep(0)


class DatedDevice(SerialDevice):
    """A device that notes when it took each reading: when it looked at its clock."""

    def __init__(self, line: Terminal) -> None:
        self.taken_s: dict[int, float] = {}
        self._looked_s = 0.0
        super().__init__(line)

    def device_us(self) -> int:
        device_us = super().device_us()
        self._looked_s = uptime_s()
        return device_us

    def send(self, message: Message) -> None:
        if isinstance(message, messages.Reading):
            self.taken_s[message.sequence] = self._looked_s
        super().send(message)


@asynccontextmanager
async def device_behind(held_s: float) -> AsyncIterator[tuple[DatedDevice, str]]:
    """A device behind an adapter that holds back for so long, and the path of the adapter."""
    adapter = Adapter()
    device = DatedDevice(adapter)
    delivering = asyncio.create_task(adapter.deliver_every(held_s))
    try:
        yield device, adapter.path
    finally:
        delivering.cancel()
        device.stop()
        adapter.unplug()


def source(path: str, rate_hz: float = 200.0) -> BoardSource:
    return BoardSource(SerialLine(kind="serial", port=path), [0, 1], rate_hz, adc_bits=[16, 16])


def lateness(device: DatedDevice, readings: list[Reading]) -> list[float]:
    """Return by how much the stamp of each reading is later than the truth [s]; negative: earlier."""
    return [reading.monotonic_s - device.taken_s[int(reading.counts[0] or 0) - 20_000] for reading in readings]


@pytest.mark.parametrize(("held_s", "rate_hz"), [(0.1, 200.0), (0.4, 200.0), (0.7, 10.0)])
@pytest.mark.parametrize("was_running", [False, True], ids=["a fresh device", "a device that still sends"])
async def test_no_reading_of_a_bursting_line_is_stamped_newer_than_it_is(
    held_s: float, rate_hz: float, was_running: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(board, "SILENCE_S", PATIENCE_S)
    async with device_behind(held_s) as (device, path):
        if was_running:
            device.restart(round(rate_hz))
            await asyncio.sleep(0.2)
        readings = await first_readings(source(path, rate_hz), round(2.2 * rate_hz))
        late, lost = lateness(device, readings), sum(reading.lost for reading in readings)
    assert max(late) < 0.002, (late[0], max(late))
    assert lost == 0


def held(_number: int, frame: bytes) -> Pieces:
    """What an adapter makes of an answer that it holds back."""
    return [(0.08, frame)]


@pytest.mark.parametrize("kind", ["rtu", "tcp"])
async def test_no_reading_of_a_bus_that_answers_late_is_stamped_newer_than_it_is(kind: str) -> None:
    unit = StampingUnit(held)
    async with AsyncExitStack() as stack:
        if kind == "tcp":
            table = configs.tcp(await stack.enter_async_context(tcp_unit(unit)))
        else:
            bus = stack.enter_context(terminal())
            await stack.enter_async_context(rtu_units(bus, {1: unit}))
            table = f"{configs.rtu(bus.path)}\ntimeout_ms = 5000"
        readings = await first_readings(polled(table, [0, 1], 10.0), 12)
    late = [unit.age_s(counts, reading.monotonic_s) for reading in readings for counts in reading.counts if counts]
    assert max(late) < 0.002


async def test_readings_of_a_plain_line_are_stamped_as_old_as_they_are() -> None:
    with terminal() as line:
        device = DatedDevice(line)
        late = sorted(lateness(device, await first_readings(source(line.path), 200)))
    assert late[-1] < 0.002
    # The adapter holds nothing back: only a busy machine makes it earlier, and not all the time.
    assert late[len(late) * 9 // 10] > -0.05
