"""Modbus TCP against pymodbus's own server and against a unit with every fault of a network."""

import asyncio
import math
import socket
from contextlib import aclosing

import pytest
from pymodbus.constants import ExcCodes

from beamtouch_common.uptime import uptime_s

from .devices import Fault, NumberingUnit, Pieces, StampingUnit, pymodbus_server, tcp_unit
from .sessions import Reading, Source, SourceError, first_readings, polled, take_across_sessions

pytestmark = pytest.mark.anyio


def table(port: int, timeout_ms: float = 10_000.0) -> str:
    return f'kind = "modbus-tcp"\nhost = "127.0.0.1"\nport = {port}\ntimeout_ms = {timeout_ms}'


def make_source(port: int, registers: list[int], rate_hz: float = 200.0, timeout_ms: float = 10_000.0) -> Source:
    return polled(table(port, timeout_ms), registers, rate_hz)


async def test_readings_are_in_the_order_of_the_channels_and_stamped_before_the_device_took_them() -> None:
    requests: list[tuple[float, float]] = []

    async def action(_function: int, _start: int, _address: int, _count: int, _now: list[int], _set: object) -> None:
        begin_s = uptime_s()
        await asyncio.sleep(0.004)
        requests.append((begin_s, uptime_s()))

    async with pymodbus_server([100, 101, 102, 103], action) as port:
        readings = await first_readings(make_source(port, [3, 2], rate_hz=50.0), 30)
    assert {reading.counts for reading in readings} == {(103, 102)}
    # The request's time: after the answer before, and not after the device began with this one.
    ends_s = [-math.inf, *(end_s for _, end_s in requests[:-1])]
    for reading, before_s, (begin_s, _) in zip(readings, ends_s, requests, strict=True):
        assert before_s < reading.monotonic_s <= begin_s


@pytest.mark.parametrize(
    ("code", "said"),
    [
        (ExcCodes.ILLEGAL_FUNCTION, "exception 1: it does not know this function"),
        (ExcCodes.ILLEGAL_ADDRESS, "exception 2: it has no such register: asked for 0; addresses count from 0"),
        (ExcCodes.DEVICE_FAILURE, "exception 4: device failure"),
        (ExcCodes.GATEWAY_NO_RESPONSE, "exception 11: gateway: the device does not answer"),
    ],
)
async def test_a_refusal_is_an_error_that_says_why(code: ExcCodes, said: str) -> None:
    async def action(*_: object) -> ExcCodes:
        return code

    async with pymodbus_server([1], action) as port:
        with pytest.raises(SourceError, match=said):
            await first_readings(make_source(port, [0]), 1)


def with_head(frame: bytes, transaction: int | None = None, unit: int | None = None) -> bytes:
    """Return an answer with another transaction number, or of another unit."""
    number = frame[:2] if transaction is None else transaction.to_bytes(2, "big")
    return number + frame[2:6] + (frame[6:7] if unit is None else bytes([unit])) + frame[7:]


def with_words(frame: bytes, words: bytes) -> bytes:
    """Return an answer with another function and content."""
    return frame[:4] + (len(words) + 1).to_bytes(2, "big") + frame[6:7] + words


def at(numbers: set[int], pieces: Fault) -> Fault:
    return lambda number, frame: pieces(number, frame) if number in numbers else [(0.0, frame)]


def late(_number: int, frame: bytes) -> Pieces:
    return [(1.0, frame)]


@pytest.mark.parametrize(
    ("fault", "lost"),
    [
        (at({10, 30}, late), 2 * 2 * 80),  # 400 ms at 200 Hz, twice each time: the unit is busy with the late one
        (at({3, 4}, lambda _, frame: [(0.0, with_head(frame, transaction=0))]), 2 * 80),
        (at({3}, lambda _, frame: [(0.0, with_words(frame, b"\4\2" + frame[9:11]))]), 1),
        (at({3}, lambda _, frame: [(0.0, with_words(frame, b"\x55\1"))]), 1),  # Modbus has no such function
        (at(set(), late), 0),
        (lambda _, frame: [(0.0, with_head(frame, unit=0))], 0),  # some devices always answer as unit 0 or 255
        (lambda _, frame: [(0.0, with_head(frame, unit=255))], 0),
    ],
    ids=[
        "late",
        "without its transaction number",
        "of fewer registers",
        "undecodable",
        "right",
        "of unit 0",
        "of unit 255",
    ],
)
async def test_no_answer_is_taken_for_that_of_another_request(fault: Fault, lost: int) -> None:
    unit = NumberingUnit(fault)

    def is_newest(reading: Reading) -> None:
        assert set(reading.counts) == {unit.newest}

    async with tcp_unit(unit) as port:
        readings, errors = await take_across_sessions(make_source(port, [0, 1], timeout_ms=400.0), 40, is_newest)
    assert errors == []
    assert sum(reading.lost for reading in readings) >= lost


@pytest.mark.parametrize(
    ("head", "said"),
    [
        ({"transaction": 0}, "unit 1 answers with transaction number 0"),
        ({"unit": 7}, "unit 1 answers as unit 7; state "),
    ],
)
async def test_answers_that_never_fit_are_an_error_that_says_so(head: dict[str, int], said: str) -> None:
    async with tcp_unit(StampingUnit(lambda _, frame: [(0.0, with_head(frame, **head))])) as port:
        with pytest.raises(SourceError, match=said):
            await first_readings(make_source(port, [0], timeout_ms=500.0), 1)


async def test_a_device_that_closes_the_connection_after_each_answer_is_read() -> None:
    async with tcp_unit(StampingUnit(), closes=True) as port:
        _, errors = await take_across_sessions(make_source(port, [0, 1]), 20)
    assert errors == []


async def test_a_device_that_is_away_costs_the_others_nothing_and_comes_back() -> None:
    async with pymodbus_server([1, 2]) as port:
        with socket.create_server(("127.0.0.2", port)) as silent:  # takes connections and never says anything
            source = polled(table(port, 500), [0, 1], 20.0, ['register = 0\nhost = "127.0.0.2"'])
            async with aclosing(source.readings()) as stream:
                (first,) = await anext(stream)
                assert first.counts == (1, 2, None)
                taken = [reading for _ in range(40) for reading in await anext(stream)]
                assert {reading.counts for reading in taken} == {(1, 2, None)}
                # Waiting for it would cost ten slots of 50 ms with each reading; a busy machine costs a few in all.
                assert sum(reading.lost for reading in taken) < 4 * len(taken)
                silent.close()
                async with pymodbus_server([7], port=port, host="127.0.0.2"), asyncio.timeout(60):
                    while (await anext(stream))[0].counts != (1, 2, 7):
                        pass
