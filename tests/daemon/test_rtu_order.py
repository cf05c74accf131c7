"""Values on a serial bus are requested only from a unit that owes no answer, whatever happens meanwhile."""

import asyncio
from collections.abc import AsyncIterator

import pytest

from beamtouch_daemon.sources.configured import Buses
from beamtouch_daemon.sources.reading import NoAnswerError, Reading, SourceError
from beamtouch_daemon.sources.registers import Block
from beamtouch_daemon.sources.rtu_unit import Request

from .devices import NumberingUnit, Pieces, StampingUnit, rtu_units, with_crc
from .lines import terminal
from .publishing import until
from .sessions import source_in, take_across_sessions

pytestmark = pytest.mark.anyio

TIMEOUT_S = 2.0
READ, REGISTERS = 4, 3
PLACES = [f"register = {index}" for index in range(REGISTERS)]


def table(path: str, unit: int, timeout_s: float = TIMEOUT_S) -> str:
    return f'kind = "modbus-rtu"\nport = "{path}"\ntimeout_ms = {timeout_s * 1e3}\nunit = {unit}'


def is_value(frame: bytes) -> bool:
    """Whether a frame answers a request for the values of the surface."""
    return frame[1:3] == bytes([READ, 2 * REGISTERS])


async def until_it_ends(stream: AsyncIterator[list[Reading]]) -> None:
    async for _ in stream:
        pass


async def test_an_answer_to_an_earlier_program_in_the_silence_of_a_start_is_followed_by_probes() -> None:
    sent: list[str] = []
    foreign = with_crc(bytes([1, READ, 2 * REGISTERS]) + b"\xee" * 2 * REGISTERS)

    def late(_number: int, frame: bytes) -> Pieces:
        sent.append("value" if is_value(frame) else "probe")
        if sent.count("probe") > 4 or sent[-1] == "value":
            return [(0.0, frame)]
        sent.append("foreign")
        return [(0.0, frame), (0.02, foreign)]

    with terminal() as line:
        async with rtu_units(line, {1: NumberingUnit(late)}):
            readings, errors = await take_across_sessions(source_in({}, table(line.path, 1), PLACES, 20.0), 5)
    assert errors == []
    first = sent.index("value", 1)
    # Both probes are found, both prove, and both prove again after what came in the silence.
    assert sent[:first] == ["value", *["probe", "foreign"] * 4, "probe", "probe"]
    begin = first - sent[:first].count("foreign")
    assert [reading.counts for reading in readings] == [(begin + number,) * REGISTERS for number in range(5)]


async def test_a_unit_that_gets_other_registers_while_a_request_waits_is_probed_first() -> None:
    slow = StampingUnit(lambda _number, frame: [(0.2, frame)])
    quick = StampingUnit()
    with terminal() as line:
        async with rtu_units(line, {1: quick, 2: slow}):
            buses: Buses = {}
            for unit in (1, 2):
                source_in(buses, table(line.path, unit), PLACES, 20.0)
            (bus,) = buses.values()
            request = Request(READ, Block(0, REGISTERS))
            one, other = (bus.unit(unit, READ, ()) for unit in (1, 2))
            async with bus.used():
                await bus.read(one, request, TIMEOUT_S)
                await bus.read(other, request, TIMEOUT_S)
                begun = slow.requests
                holds = asyncio.create_task(bus.read(other, request, TIMEOUT_S))
                await until(lambda: slow.requests > begun)
                waits = asyncio.create_task(bus.read(one, request, TIMEOUT_S))
                await asyncio.sleep(0)  # it now waits for the other's answer
                bus.unit(1, READ, [Block(0, REGISTERS + 2)])  # as a new configuration does
                with pytest.raises(NoAnswerError, match="other registers are read"):
                    await waits
                await holds
                asked = quick.requests
                await bus.read(one, request, TIMEOUT_S)
                assert quick.requests >= asked + 3  # two probes and the values


@pytest.mark.long
async def test_a_port_that_is_unplugged_while_a_dead_unit_is_tried_again_ends_the_session() -> None:
    unanswered: list[int] = []
    with terminal() as line:
        async with rtu_units(line, {1: StampingUnit()}, unanswered):
            places = [*PLACES, "register = 0\nunit = 2"]
            stream = source_in({}, table(line.path, 1, timeout_s=1.0), places, 20.0).readings()
            reads = asyncio.create_task(until_it_ends(stream))
            await until(lambda: len(unanswered) > 1)  # the first request gives the unit up, the second tries it again
            line.unplug()
            with pytest.raises(SourceError, match="is gone"):
                await reads
