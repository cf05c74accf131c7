"""Our own protocol over a pseudo-terminal, against a small device."""

import asyncio
import random
from collections.abc import AsyncGenerator
from contextlib import aclosing
from itertools import pairwise

import pytest

from beamtouch_daemon.config.sources import SerialLine
from beamtouch_daemon.sources.board import BoardSource
from beamtouch_daemon.sources.reading import Reading, SourceError, first_readings
from beamtouch_daemon.uptime import uptime_s
from beamtouch_protocol import messages

from .devices import SerialDevice
from .lines import terminal
from .publishing import until

pytestmark = pytest.mark.anyio

RATE_HZ = 200.0


def make_source(path: str, indices: list[int] | None = None, rate_hz: float = RATE_HZ) -> BoardSource:
    settings = SerialLine(kind="serial", port=path, baud=1_000_000)
    return BoardSource(settings, indices or [0, 1], rate_hz, adc_bits=[16, 16])


async def drain(stream: AsyncGenerator[list[Reading], None], within_s: float = 60.0) -> None:
    """Read until it fails."""
    async with asyncio.timeout(within_s):
        async for _ in stream:
            pass


async def test_a_session_is_stop_hello_start_readings_stop() -> None:
    with terminal() as line:
        device = SerialDevice(line)
        readings = await first_readings(make_source(line.path, [1, 0]), 20)
        await until(lambda: device.received[-1] == messages.Stop())
        session = [message for message in device.received if not isinstance(message, messages.Ping)]
        assert session == [messages.Stop(), messages.HelloRequest(), messages.Start(200, 1), messages.Stop()]
        pings = [message for message in device.received if isinstance(message, messages.Ping)]
        assert [ping.token for ping in pings] == [(pings[0].token + i) % 2**16 for i in range(len(pings))]
        assert device.received.index(pings[0]) < device.received.index(messages.Start(200, 1))
        assert [reading.counts for reading in readings] == [(21_000 + i, 20_000 + i) for i in range(20)]
        assert sum(reading.lost for reading in readings) == 0


async def test_times_follow_the_device_clock_across_its_wrap_and_are_never_later_than_now() -> None:
    with terminal() as line:
        SerialDevice(line)
        begin_s = uptime_s()
        readings = await first_readings(make_source(line.path), 100)
        end_s = uptime_s()
    assert all(later.monotonic_s >= earlier.monotonic_s for earlier, later in pairwise(readings))
    assert begin_s <= readings[0].monotonic_s < readings[-1].monotonic_s - 0.4
    assert readings[-1].monotonic_s <= end_s


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
        settings = SerialLine(kind="serial", port=line.path, oversampling=16)
        source = BoardSource(settings, [0], RATE_HZ, adc_bits=[12])
        async with aclosing(source.readings()) as stream:
            assert (await anext(stream))[0].counts == (device.counts(0)[0],)
            device.stop()
            await asyncio.sleep(0.05)
            first = device.sequence
            device.send(messages.Reading(first, 0xFFFF_F000, 16, (16 * 4095 + 1, 5)))  # more than 12 bits give
            device.send(messages.Reading(first + 1, 0xFFFF_F000, 0, (0, 0)))
            device.send(messages.Reading(first + 2, 0xFFFF_F000, 16, (16 * 7 + 3, 5)))
            taken = await anext(stream)
            while taken[-1].counts != (7.1875,):
                taken += await asyncio.wait_for(anext(stream), 60)
        assert all(reading.counts[0] <= 4095 for reading in taken if reading.counts[0] is not None)


async def test_sums_that_do_not_fit_are_refused() -> None:
    with terminal() as line:
        SerialDevice(line)
        settings = SerialLine(kind="serial", port=line.path, oversampling=2)
        with pytest.raises(SourceError, match="sums of 2 conversions of 16 bits do not fit; lower oversampling"):
            await first_readings(BoardSource(settings, [0], 200.0, adc_bits=[16]), 1)


async def test_a_repeated_frame_is_not_a_second_reading() -> None:
    with terminal() as line:
        device = SerialDevice(line)
        async with aclosing(make_source(line.path).readings()) as stream:
            await anext(stream)
            device.stop()
            await asyncio.sleep(0.05)
            device.send(messages.Reading(device.sequence + 1, 0xFFFF_F000, 1, (1, 1)))
            device.send(messages.Reading(device.sequence + 1, 0xFFFF_F000, 1, (1, 1)))
            device.send(messages.Reading(device.sequence, 0xFFFF_F000, 1, (1, 1)))
            device.send(messages.Reading(device.sequence + 2, 0xFFFF_F001, 1, (2, 2)))
            taken: list[Reading] = []
            while not taken or taken[-1].counts != (2, 2):
                taken += await asyncio.wait_for(anext(stream), 60)
        assert [reading.counts for reading in taken if reading.counts in {(1, 1), (2, 2)}] == [(1, 1), (2, 2)]


async def test_a_reset_device_begins_a_new_session() -> None:
    with terminal() as line:
        device = SerialDevice(line)
        source = make_source(line.path)
        async with aclosing(source.readings()) as stream:
            await anext(stream)
            device.reset(boot_id=2)
            with pytest.raises(SourceError, match="the device was reset"):
                await drain(stream)
        assert (await first_readings(source, 1))[0].counts == (20_000, 21_000)


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


async def test_a_clock_that_goes_back_shows_in_the_answer_to_a_ping_too() -> None:
    with terminal() as line:
        device = SerialDevice(line)
        async with aclosing(make_source(line.path).readings()) as stream:
            await anext(stream)
            device.stop()
            last_us = device.device_us()

            async def hold_back() -> None:
                # An adapter still delivers readings from before.
                for number in range(10_000):
                    device.send(messages.Reading((device.sequence + number) % 2**16, last_us + 50 * number, 1, (1, 1)))
                    await asyncio.sleep(0.005)

            held = asyncio.create_task(hold_back())
            device.set_back(30.0)
            with pytest.raises(SourceError, match="the device's clock went back"):
                await drain(stream)
            held.cancel()


async def test_noise_and_damaged_frames_give_nothing() -> None:
    with terminal() as line:
        device = SerialDevice(line)
        async with aclosing(make_source(line.path).readings()) as stream:
            taken, chance = await anext(stream), random.Random(3)  # noqa: S311 - noise, not secrets
            for _ in range(20):
                line.write(chance.randbytes(50))
                taken += await anext(stream)
        assert all(first and second == first + 1000 for first, second in (reading.counts for reading in taken))
        assert device.sequence > 10


@pytest.mark.parametrize(
    ("device", "indices", "rate_hz", "complaint"),
    [
        ({"schema_hash": 0}, [0, 1], 200.0, r"speaks protocol 1 \(00000000\).*update the older"),
        ({"channels": 1}, [0, 1], 200.0, "the device has 1 channels; register 1 is beyond the last"),
        ({}, [0, 1], 1001.0, "at most 1000 readings per second; lower rate_hz"),
    ],
)
async def test_a_device_that_the_configuration_does_not_describe_is_refused(
    device: dict[str, int], indices: list[int], rate_hz: float, complaint: str
) -> None:
    with terminal() as line:
        SerialDevice(line, **device)
        with pytest.raises(SourceError, match=complaint):
            await first_readings(make_source(line.path, indices, rate_hz), 1)


async def test_other_adc_bits_than_configured_are_refused() -> None:
    with terminal() as line:
        SerialDevice(line)
        settings = SerialLine(kind="serial", port=line.path)
        with pytest.raises(SourceError, match="the device has 16 ADC bits; correct adc_bits"):
            await first_readings(BoardSource(settings, [0], 200.0, adc_bits=[12]), 1)


async def test_a_silent_device_is_an_error_in_the_hello_and_in_the_stream(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("beamtouch_daemon.sources.board.HELLO_TIMEOUT_S", 0.4)

    with terminal() as line:
        with pytest.raises(SourceError, match=r"no hello within 0\.4 s"):
            await first_readings(make_source(line.path), 1)
        device = SerialDevice(line)
        async with aclosing(make_source(line.path).readings()) as stream:
            await anext(stream)
            device.stop()
            with pytest.raises(SourceError, match=r"no reading for 0\.5 s"):
                await drain(stream)


async def test_an_unplugged_port_is_an_error_at_once() -> None:
    with terminal() as line:
        device = SerialDevice(line)
        async with aclosing(make_source(line.path).readings()) as stream:
            await anext(stream)
            device.stop()
            line.unplug()
            with pytest.raises(SourceError, match=r"is gone|accepts no data"):
                await drain(stream)


async def test_a_port_in_use_is_an_error() -> None:
    with terminal() as line:
        SerialDevice(line)
        async with aclosing(make_source(line.path).readings()) as stream:
            await anext(stream)
            with pytest.raises(
                SourceError,
                match=r"cannot be opened \(Resource temporarily unavailable\); another program uses it: stop that one",
            ):
                await first_readings(make_source(line.path), 1)
