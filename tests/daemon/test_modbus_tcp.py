"""Modbus TCP against pymodbus's own server and against a unit that answers late."""

import asyncio
import socket
from itertools import pairwise
from time import monotonic

import pytest
from pymodbus.constants import ExcCodes

from beamtouch_daemon.config import ModbusTcp
from beamtouch_daemon.sources.modbus import Block, blocks_of
from beamtouch_daemon.sources.modbus_tcp import ModbusTcpSource
from beamtouch_daemon.sources.reading import Reading, SourceError

from .devices import Pieces, StampingUnit, pymodbus_server, tcp_unit
from .sessions import take, take_across_sessions


def make_source(port: int, registers: list[int], rate_hz: float = 200.0, timeout_ms: float = 500.0) -> ModbusTcpSource:
    settings = ModbusTcp(kind="modbus-tcp", host="127.0.0.1", port=port, timeout_ms=timeout_ms)
    return ModbusTcpSource(settings, registers, rate_hz)


def test_registers_in_a_row_are_one_request() -> None:
    assert blocks_of([3, 1, 2]) == (Block(1, 3),)
    assert blocks_of([0, 1, 7]) == (Block(0, 2), Block(7, 1))
    assert blocks_of(range(126)) == (Block(0, 125), Block(125, 1))


def test_channels_come_in_the_order_of_the_configuration() -> None:
    async def story() -> None:
        async with pymodbus_server([100, 101, 102, 0, 104]) as port:
            (reading,) = await take(make_source(port, [4, 0, 2]), 1)
            assert reading.counts == (104, 100, 102)

    asyncio.run(story())


def test_readings_keep_the_schedule_and_are_stamped_within_their_own_request() -> None:
    requests: list[tuple[float, float]] = []

    async def action(_function: int, _start: int, _address: int, _count: int, _now: list[int], _set: object) -> None:
        begin_s = monotonic()
        await asyncio.sleep(0.004)
        requests.append((begin_s, monotonic()))

    async def story() -> list[Reading]:
        async with pymodbus_server([1, 2], action) as port:
            return await take(make_source(port, [0, 1], rate_hz=50.0), 50)

    readings = asyncio.run(story())
    for reading, (begin_s, end_s) in zip(readings, requests, strict=True):
        assert begin_s - 0.02 < reading.monotonic_s < end_s + 0.02
    slots = len(readings) - 1 + sum(reading.lost for reading in readings[1:])
    assert readings[-1].monotonic_s - readings[0].monotonic_s == pytest.approx(slots / 50.0, abs=0.02)
    assert all(later.monotonic_s > earlier.monotonic_s for earlier, later in pairwise(readings))


def test_a_register_that_is_not_there_is_an_error_that_says_so() -> None:
    async def story() -> None:
        async with pymodbus_server([1, 2]) as port:
            with pytest.raises(SourceError, match=r"exception 2: it has no such input register"):
                await take(make_source(port, [40]), 1)

    asyncio.run(story())


def test_a_channel_that_the_device_refuses_is_missing_and_the_others_are_there() -> None:
    async def story() -> None:
        async with pymodbus_server([1, 2]) as port:
            (reading,) = await take(make_source(port, [0, 1, 40]), 1)
            assert reading.counts == (1, 2, None)

    asyncio.run(story())


def test_a_device_failure_is_an_error() -> None:
    async def action(*_: object) -> ExcCodes:
        return ExcCodes.DEVICE_FAILURE

    async def story() -> None:
        async with pymodbus_server([1], action) as port:
            with pytest.raises(SourceError, match="exception 4: device failure"):
                await take(make_source(port, [0]), 1)

    asyncio.run(story())


def test_a_host_that_refuses_is_an_error() -> None:
    with socket.socket() as unused:
        unused.bind(("127.0.0.1", 0))
        port = unused.getsockname()[1]
        with pytest.raises(SourceError, match=f"no connection to 127.0.0.1:{port}"):
            asyncio.run(take(make_source(port, [0]), 1))


def test_a_server_that_goes_away_is_an_error_within_the_timeout_and_can_be_read_again() -> None:
    async def story() -> None:
        async with pymodbus_server([1, 2]) as port:
            source = make_source(port, [0, 1], timeout_ms=100.0)
            stream = source.readings()
            await anext(stream)
        with pytest.raises(SourceError, match=r"does not answer within 100 ms"):
            await asyncio.wait_for(anext(stream), 2)
        async with pymodbus_server([3, 4], port=port):
            (reading,) = await take(source, 1)
            assert reading.counts == (3, 4)

    asyncio.run(story())


def test_a_late_answer_is_never_taken_for_a_later_one() -> None:
    unit = StampingUnit(lambda number, frame: [(0.25 if number % 20 == 10 else 0.0, frame)])

    async def story() -> tuple[list[Reading], list[str]]:
        async with tcp_unit(unit) as port:
            return await take_across_sessions(make_source(port, [0, 1], timeout_ms=100.0), 60)

    readings, errors = asyncio.run(story())
    assert len(errors) >= 3
    ages_s = [unit.age_s(counts, reading.monotonic_s) for reading in readings for counts in reading.counts if counts]
    assert len(ages_s) == 120
    assert max(ages_s) < 0.07  # half a timeout, and the time the test itself needs; a late answer is 0.2 s old


def test_an_answer_to_something_else_is_an_error() -> None:
    def shorten(number: int, frame: bytes) -> Pieces:
        fewer = frame[:4] + b"\x00\x05" + frame[6:8] + b"\x02" + frame[9:11]  # one register where two were asked for
        return [(0.0, fewer if number == 3 else frame)]

    unit = StampingUnit(shorten)

    async def story() -> tuple[list[Reading], list[str]]:
        async with tcp_unit(unit) as port:
            return await take_across_sessions(make_source(port, [0, 1]), 5)

    _, errors = asyncio.run(story())
    assert errors == ["unit 1 gave the answer to another request"]
