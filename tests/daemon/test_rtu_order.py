"""Values on a serial bus are requested only from a unit that owes no answer, whatever happens meanwhile."""

import asyncio
from collections.abc import AsyncIterator

import pytest

from beamtouch_daemon.sources.configured import Buses
from beamtouch_daemon.sources.reading import Reading, SourceError

from .devices import NumberingUnit, Pieces, StampingUnit, rtu_units, with_crc
from .lines import terminal
from .publishing import until
from .sessions import source_in, take_across_sessions

pytestmark = pytest.mark.anyio

TIMEOUT_S = 2.0
READ, REGISTERS = 4, 3
PLACES = [f"register = {index}" for index in range(REGISTERS)]
VALUES = bytes([READ, 2 * REGISTERS])
"""Function and length of an answer with the values of the surface."""


def table(path: str, unit: int, timeout_s: float = TIMEOUT_S) -> str:
    return f'kind = "modbus-rtu"\nport = "{path}"\ntimeout_ms = {timeout_s * 1e3}\nunit = {unit}'


def is_value(frame: bytes) -> bool:
    """Whether a frame answers a request for the values of the surface."""
    return frame[1:3] == VALUES


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


async def test_a_unit_of_which_other_registers_are_read_proves_again_that_it_owes_nothing() -> None:
    asked: list[bytes] = []

    def note(_number: int, frame: bytes) -> Pieces:
        asked.append(frame[1:3])
        return [(0.01, frame)]

    with terminal() as line:
        async with rtu_units(line, {1: NumberingUnit(note)}):
            buses: Buses = {}
            stream = source_in(buses, table(line.path, 1), PLACES, 20.0).readings()
            await anext(stream)
            first = [kind for kind in asked if kind != VALUES]
            del asked[:]
            # Whatever was a probe so far may be as long as these values are, and its late answer looks like them.
            lengths = [kind[1] // 2 for kind in first if kind[0] == READ] or [REGISTERS + 2]
            places = [f"register = {register}" for register in range(lengths[0])]
            other = asyncio.create_task(take_across_sessions(source_in(buses, table(line.path, 1), places, 20.0), 3))
            while not other.done():
                await anext(stream)
            readings, errors = await other
            await stream.aclose()
    other_values = bytes([READ, 2 * lengths[0]])
    begin = next(place for place, kind in enumerate(asked) if kind not in {VALUES, other_values})
    assert asked[:begin].count(other_values) <= 1  # a unit that answers anything answers this
    probes = asked[begin : begin + 4]
    assert not {VALUES, other_values} & set(probes)
    assert probes[:2] == probes[2:]  # two are found, and both prove
    assert errors == []
    assert len(readings) == 3


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
