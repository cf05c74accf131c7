"""Our own protocol over a pseudo-terminal, against a small device: readings, their times, and every kind of failure."""

import asyncio
from collections.abc import AsyncGenerator, AsyncIterator
from contextlib import aclosing, asynccontextmanager, suppress
from typing import Any

import pytest

from beamtouch_common.uptime import uptime_s
from beamtouch_protocol import messages
from beamtouch_protocol.messages import HelloRequest, Message, Ping, Pong, Start, Stop
from support.surfaces import configs

from .devices import SerialDevice, StampingUnit, rtu_units
from .lines import Terminal, terminal
from .sessions import Reading, Source, SourceError, change_waits, first_readings, polled, source_in
from .waits import until

pytestmark = pytest.mark.anyio

RATE_HZ = 200.0
PATIENCE_S = 10.0
"""Silence that ends a session, in place of the daemon's 0.5 s: on a busy machine, a burst that was held back for 0.4 s
may arrive later than that."""
PIECE_BYTES = 62
"""Bytes of a serial line in one USB packet: a burst arrives in pieces of this size."""


def make_source(
    path: str, indices: list[int] | None = None, rate_hz: float = RATE_HZ, bits: int = 16, oversampling: int = 1
) -> Source:
    places = [f"register = {index}\nadc_bits = {bits}" for index in indices or [0, 1]]
    return source_in({}, f"{configs.serial(path)}\noversampling = {oversampling}", places, rate_hz)


async def drain(stream: AsyncGenerator[list[Reading], None]) -> None:
    """Read until it fails."""
    async with asyncio.timeout(60.0):
        async for _ in stream:
            pass


async def until_counts(stream: AsyncGenerator[list[Reading], None], counts: tuple[float, ...]) -> list[Reading]:
    """Read up to a reading with these counts."""
    taken: list[Reading] = []
    async with asyncio.timeout(60.0):
        while not taken or taken[-1].counts != counts:
            taken += await anext(stream)
    return taken


async def test_a_session_is_stop_hello_start_readings_stop() -> None:
    with terminal() as line:
        device = SerialDevice(line)
        readings = await first_readings(make_source(line.path, [1, 0]), 20)
        await until(lambda: device.received[-1] == Stop())
        session = [message for message in device.received if not isinstance(message, Ping)]
        assert session == [Stop(), HelloRequest(), Start(200, 1), Stop()]
        pings = [message for message in device.received if isinstance(message, Ping)]
        assert [ping.token for ping in pings] == [(pings[0].token + i) % 2**16 for i in range(len(pings))]
        assert device.received.index(pings[0]) < device.received.index(Start(200, 1))
        assert [reading.counts for reading in readings] == [(21_000 + i, 20_000 + i) for i in range(20)]
        assert sum(reading.lost for reading in readings) == 0


async def test_lost_readings_are_counted_and_not_invented() -> None:
    with terminal() as line:
        device = SerialDevice(line)
        async with aclosing(make_source(line.path).readings()) as stream:
            before = await anext(stream)
            device.lose(7)
            after = [reading for _ in range(5) for reading in await anext(stream)]
        assert before[0].lost == 0
        assert sum(reading.lost for reading in after) == 7


async def test_a_count_is_the_mean_of_the_conversions_that_were_asked_for() -> None:
    with terminal() as line:
        device = SerialDevice(line, adc_bits=12)
        async with aclosing(make_source(line.path, [0], bits=12, oversampling=16).readings()) as stream:
            assert (await anext(stream))[0].counts == (device.counts(0)[0],)
            device.stop()
            first = device.sequence
            device.send(messages.Reading(first, 0xFFFF_F000, 16, (16 * 4095 + 1, 5)))  # more than 12 bits give
            device.send(messages.Reading(first + 1, 0xFFFF_F000, 0, (0, 0)))
            device.send(messages.Reading(first + 2, 0xFFFF_F000, 16, (16 * 7 + 3, 5)))
            taken = await until_counts(stream, (7.1875,))
        assert all(reading.counts[0] <= 4095 for reading in taken if reading.counts[0] is not None)


async def test_a_repeated_frame_is_not_a_second_reading() -> None:
    with terminal() as line:
        device = SerialDevice(line)
        async with aclosing(make_source(line.path).readings()) as stream:
            await anext(stream)
            device.stop()
            number = device.sequence
            for sequence, counts in ((number + 1, 1), (number + 1, 1), (number, 1), (number + 2, 2)):
                device.send(messages.Reading(sequence, 0xFFFF_F000 + counts, 1, (counts, counts)))
            taken = await until_counts(stream, (2, 2))
        assert [reading.counts for reading in taken if reading.counts in {(1, 1), (2, 2)}] == [(1, 1), (2, 2)]


async def test_a_device_whose_clock_goes_back_begins_a_new_session_with_fresh_readings() -> None:
    back_s = 30.0
    with terminal() as line:
        device = SerialDevice(line)
        async with aclosing(make_source(line.path).readings()) as stream:
            async with asyncio.timeout(60):
                for _ in range(20):
                    await anext(stream)
            device.set_back(back_s)
            with pytest.raises(SourceError, match="the device's clock went back"):
                await drain(stream)
        readings = await first_readings(make_source(line.path), 20)
        assert uptime_s() - readings[-1].monotonic_s < back_s / 2


@pytest.mark.parametrize(
    ("device", "source", "complaint"),
    [
        ({"schema_hash": 0}, {}, r"speaks protocol 1 \(00000000\).*update the older"),
        ({"channels": 1}, {}, "the device has 1 channels; register 1 is beyond the last"),
        ({}, {"rate_hz": 1001.0}, "at most 1000 readings per second; lower rate_hz"),
        ({}, {"bits": 12}, "the device has 16 ADC bits; correct adc_bits"),
        ({}, {"oversampling": 2}, "sums of 2 conversions of 16 bits do not fit; lower oversampling"),
    ],
)
async def test_a_device_that_the_configuration_does_not_describe_is_refused(
    device: dict[str, int], source: dict[str, Any], complaint: str
) -> None:
    with terminal() as line:
        SerialDevice(line, **device)
        with pytest.raises(SourceError, match=complaint):
            await first_readings(make_source(line.path, **source), 1)


class WithoutClock(SerialDevice):
    """A device that answers no ping."""

    def send(self, message: Message) -> None:
        if not isinstance(message, Pong):
            super().send(message)


async def test_a_silent_device_is_an_error_in_the_hello_at_the_ping_and_in_the_stream(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    change_waits(monkeypatch, hello_s=0.4, boot_s=0.4)
    with terminal() as line:
        with pytest.raises(SourceError, match="no hello of a Beamtouch board; the port is open, but not a byte came"):
            await first_readings(make_source(line.path), 1)
        WithoutClock(line)
        with pytest.raises(SourceError, match=r"no answer to a ping within 0\.4 s, so the age of its readings is"):
            await first_readings(make_source(line.path), 1)
        change_waits(monkeypatch, hello_s=60.0)
        device = SerialDevice(line)
        async with aclosing(make_source(line.path).readings()) as stream:
            await anext(stream)
            device.stop()
            with pytest.raises(SourceError, match=r"no reading for 0\.5 s"):
                await drain(stream)


async def test_a_port_that_is_in_use_or_unplugged_is_an_error_at_once() -> None:
    with terminal() as line:
        device = SerialDevice(line)
        async with aclosing(make_source(line.path).readings()) as stream:
            await anext(stream)
            in_use = r"cannot be opened \(Resource temporarily unavailable\); another program uses it: stop that one"
            with pytest.raises(SourceError, match=in_use):
                await first_readings(make_source(line.path), 1)
            device.stop()
            line.unplug()
            with pytest.raises(SourceError, match=r"is gone|accepts no data"):
                await drain(stream)


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

    def lateness(self, readings: list[Reading]) -> list[float]:
        """Return by how much the stamp of each reading is later than the truth [s]; negative: earlier."""
        return [reading.monotonic_s - self.taken_s[int(reading.counts[0] or 0) - 20_000] for reading in readings]


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
        with suppress(asyncio.CancelledError):
            await delivering
        device.stop()
        adapter.unplug()


@pytest.mark.parametrize(
    ("held_s", "rate_hz", "still_sends"),
    [(0.1, 200.0, False), (0.7, 10.0, True)],
)
async def test_no_reading_of_a_bursting_line_is_stamped_newer_than_it_is(
    held_s: float, rate_hz: float, still_sends: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    change_waits(monkeypatch, silence_s=PATIENCE_S)
    async with device_behind(held_s) as (device, path):
        if still_sends:
            device.restart(round(rate_hz))
            await until(lambda: device.sequence > 2)
        readings = await first_readings(make_source(path, rate_hz=rate_hz), round(2.0 * rate_hz))
        late, lost = device.lateness(readings), sum(reading.lost for reading in readings)
    assert max(late) < 0.002, (late[0], max(late))
    assert lost == 0


async def test_no_reading_of_a_bus_that_answers_late_is_stamped_newer_than_it_is() -> None:
    unit = StampingUnit(lambda _number, frame: [(0.08, frame)])
    with terminal() as bus:
        async with rtu_units(bus, {1: unit}):
            table = f"{configs.rtu(bus.path)}\ntimeout_ms = 5000"
            readings = await first_readings(polled(table, [0, 1], 10.0), 12)
    late = [unit.age_s(counts, reading.monotonic_s) for reading in readings for counts in reading.counts if counts]
    assert max(late) < 0.002
