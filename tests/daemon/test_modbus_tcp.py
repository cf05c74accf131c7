"""Modbus TCP against pymodbus's own server and against a unit that answers late."""

import asyncio
import math
import socket
from contextlib import aclosing

import numpy as np
import pytest
from pymodbus.constants import ExcCodes

from beamtouch_daemon.sources.polled import PolledSource
from beamtouch_daemon.sources.reading import Reading, SourceError, first_readings
from beamtouch_daemon.uptime import uptime_s

from .devices import NumberingUnit, Pieces, StampingUnit, pymodbus_server, tcp_unit
from .sessions import polled, take_across_sessions

pytestmark = pytest.mark.anyio


def make_source(port: int, registers: list[int], rate_hz: float = 200.0, timeout_ms: float = 10_000.0) -> PolledSource:
    table = f'kind = "modbus-tcp"\nhost = "127.0.0.1"\nport = {port}\ntimeout_ms = {timeout_ms}'
    return polled(table, registers, rate_hz)


async def test_channels_come_in_the_order_of_the_configuration() -> None:
    async with pymodbus_server([100, 101, 102, 0, 104]) as port:
        (reading,) = await first_readings(make_source(port, [4, 0, 2]), 1)
        assert reading.counts == (104, 100, 102)


async def test_readings_keep_the_schedule_and_are_stamped_within_their_own_request() -> None:
    requests: list[tuple[float, float]] = []

    async def action(_function: int, _start: int, _address: int, _count: int, _now: list[int], _set: object) -> None:
        begin_s = uptime_s()
        await asyncio.sleep(0.004)
        requests.append((begin_s, uptime_s()))

    async with pymodbus_server([1, 2], action) as port:
        readings = await first_readings(make_source(port, [0, 1], rate_hz=50.0), 50)
    # The request's time: after the answer before, and not after the device began with this one.
    ends_s = [-math.inf, *(end_s for _, end_s in requests[:-1])]
    for reading, before_s, (begin_s, _) in zip(readings, ends_s, requests, strict=True):
        assert before_s < reading.monotonic_s <= begin_s
    # Polls of a busy machine are late, and those that are not stand on the schedule, at the end as at the beginning.
    slots = np.cumsum([1 + reading.lost for reading in readings])
    late_s = np.array([reading.monotonic_s for reading in readings]) - slots / 50.0
    assert late_s[25:].min() == pytest.approx(late_s[:25].min(), abs=0.015)


async def test_a_register_that_is_not_there_is_an_error_that_says_so() -> None:
    async with pymodbus_server([1, 2]) as port:
        with pytest.raises(SourceError, match=r"exception 2: it has no such register"):
            await first_readings(make_source(port, [40]), 1)


async def test_a_channel_that_the_device_refuses_is_missing_and_the_others_are_there(
    caplog: pytest.LogCaptureFixture,
) -> None:
    async with pymodbus_server([1, 2]) as port:
        readings = await first_readings(make_source(port, [0, 1, 40]), 3)
    assert [reading.counts for reading in readings] == [(1, 2, None)] * 3
    assert caplog.text.count("it has no such register: asked for 40") == 1


async def test_a_device_failure_is_an_error() -> None:
    async def action(*_: object) -> ExcCodes:
        return ExcCodes.DEVICE_FAILURE

    async with pymodbus_server([1], action) as port:
        with pytest.raises(SourceError, match="exception 4: device failure"):
            await first_readings(make_source(port, [0]), 1)


async def test_a_host_that_refuses_is_an_error() -> None:
    with socket.socket() as unused:
        unused.bind(("127.0.0.1", 0))
        port = unused.getsockname()[1]
        with pytest.raises(SourceError, match=f"no connection to 127.0.0.1:{port}"):
            await first_readings(make_source(port, [0]), 1)


async def test_a_server_that_goes_away_is_an_error_within_the_timeout_and_can_be_read_again() -> None:
    async with pymodbus_server([1, 2]) as port:
        source = make_source(port, [0, 1])
        stream = source.readings()
        await anext(stream)
    with pytest.raises(SourceError, match=r"does not answer within 10000 ms|no connection to"):
        await asyncio.wait_for(anext(stream), 60)
    async with pymodbus_server([3, 4], port=port):
        (reading,) = await first_readings(source, 1)
        assert reading.counts == (3, 4)


async def test_a_late_answer_is_never_taken_for_a_later_one() -> None:
    unit = NumberingUnit(lambda number, frame: [(1.0 if number % 20 == 10 else 0.0, frame)])

    def is_newest(reading: Reading) -> None:
        assert set(reading.counts) == {unit.newest}

    async with tcp_unit(unit) as port:
        readings, errors = await take_across_sessions(make_source(port, [0, 1], timeout_ms=400.0), 40, is_newest)
    assert errors == []
    assert sum(reading.lost for reading in readings) >= 2 * 2 * 80  # 400 ms at 200 Hz, twice each time


async def test_an_answer_to_something_else_is_no_reading() -> None:
    def shorten(number: int, frame: bytes) -> Pieces:
        fewer = frame[:4] + b"\x00\x05" + frame[6:8] + b"\x02" + frame[9:11]  # one register where two were asked for
        return [(0.0, fewer if number == 3 else frame)]

    unit = StampingUnit(shorten)

    async with tcp_unit(unit) as port:
        readings, errors = await take_across_sessions(make_source(port, [0, 1]), 5)
    assert errors == []
    assert sum(reading.lost for reading in readings) >= 1


async def test_a_device_that_closes_the_connection_after_each_answer_is_read_in_every_slot() -> None:
    async with tcp_unit(StampingUnit(), closes=True) as port:
        readings, errors = await take_across_sessions(make_source(port, [0, 1], rate_hz=2.0), 6)
    assert errors == []
    assert sum(reading.lost for reading in readings) <= 2  # a starved machine may miss a slot


async def test_a_device_that_is_away_costs_the_others_nothing_and_comes_back() -> None:
    async with pymodbus_server([1, 2]) as port:
        with socket.create_server(("127.0.0.2", port)) as silent:  # takes connections and never says anything
            text = f'kind = "modbus-tcp"\nhost = "127.0.0.1"\nport = {port}\ntimeout_ms = 500'
            source = polled(text, [0, 1], 20.0, ['register = 0\nhost = "127.0.0.2"'])
            async with aclosing(source.readings()) as stream:
                (first,) = await anext(stream)
                assert first.counts == (1, 2, None)
                taken = [reading for _ in range(40) for reading in await anext(stream)]
                assert {reading.counts for reading in taken} == {(1, 2, None)}
                # Waiting for it would cost ten slots of 50 ms with each reading; a busy machine costs a few in all.
                assert sum(reading.lost for reading in taken) < len(taken)
                silent.close()
                async with pymodbus_server([7], port=port, host="127.0.0.2"), asyncio.timeout(60):
                    while (await anext(stream))[0].counts != (1, 2, 7):
                        pass


def with_head(frame: bytes, transaction: int | None = None, unit: int | None = None) -> bytes:
    """Return an answer with another transaction number, or of another unit."""
    number = frame[:2] if transaction is None else transaction.to_bytes(2, "big")
    return number + frame[2:6] + (frame[6:7] if unit is None else bytes([unit])) + frame[7:]


async def test_an_answer_without_its_transaction_number_is_not_believed() -> None:
    unit = StampingUnit(lambda number, frame: [(0.0, with_head(frame, transaction=0) if number in {3, 4} else frame)])

    async with tcp_unit(unit) as port:
        readings, errors = await take_across_sessions(make_source(port, [0, 1], timeout_ms=500.0), 10)
    assert errors == []
    assert sum(reading.lost for reading in readings) >= 2 * 80  # 500 ms at 200 Hz, each time


async def test_a_device_without_transaction_numbers_is_an_error_that_says_so() -> None:
    async with tcp_unit(StampingUnit(lambda _number, frame: [(0.0, with_head(frame, transaction=0))])) as port:
        with pytest.raises(SourceError, match="unit 1 answers with transaction number 0"):
            await first_readings(make_source(port, [0], timeout_ms=500.0), 1)


@pytest.mark.parametrize("answers_as", [0, 255])
async def test_a_device_that_always_answers_as_unit_0_or_255_is_read(answers_as: int) -> None:
    async with tcp_unit(StampingUnit(lambda _number, frame: [(0.0, with_head(frame, unit=answers_as))])) as port:
        readings = await first_readings(make_source(port, [0, 1]), 5)
    assert len(readings) == 5
    assert all(None not in reading.counts for reading in readings)


async def test_the_answer_of_another_unit_is_an_error_that_names_it() -> None:
    async with tcp_unit(StampingUnit(lambda _number, frame: [(0.0, with_head(frame, unit=7))])) as port:
        with pytest.raises(SourceError, match="unit 1 answers as unit 7; state unit = 7"):
            await first_readings(make_source(port, [0], timeout_ms=500.0), 1)
