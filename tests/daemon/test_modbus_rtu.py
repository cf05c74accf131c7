"""Modbus RTU over pseudo-terminals: against pymodbus's own server, and against a unit with every fault of a bus."""

import asyncio
from collections.abc import Callable

import pytest
from pymodbus.server import ModbusSerialServer
from pymodbus.simulator import DataType, SimData, SimDevice

from beamtouch_daemon.config import ModbusRtu
from beamtouch_daemon.sources.modbus import Block
from beamtouch_daemon.sources.modbus_rtu import ModbusRtuSource, probe_of
from beamtouch_daemon.sources.reading import Reading, SourceError

from .devices import Fault, StampingUnit, rtu_unit
from .lines import joined_terminals, terminal
from .sessions import take, take_across_sessions

TIMEOUT_MS = 60.0


def make_source(path: str, registers: list[int], rate_hz: float = 100.0) -> ModbusRtuSource:
    settings = ModbusRtu(kind="modbus-rtu", port=path, baud=115_200, timeout_ms=TIMEOUT_MS)
    return ModbusRtuSource(settings, registers, rate_hz)


def run_with(fault: Fault, number: int, registers: list[int] | None = None) -> tuple[list[Reading], list[str], float]:
    """Return readings, errors, and by how much the oldest value was older than its reading said [s]."""

    async def story() -> tuple[list[Reading], list[str], float]:
        with terminal() as line:
            unit = StampingUnit(fault)
            async with rtu_unit(line, unit):
                readings, errors = await take_across_sessions(make_source(line.path, registers or [0, 1, 2]), number)
            ages_s = [
                unit.age_s(count, reading.monotonic_s) for reading in readings for count in reading.counts if count
            ]
            return readings, errors, max(ages_s)

    return asyncio.run(story())


def test_registers_are_read_from_pymodbus_own_server() -> None:
    async def story() -> None:
        with joined_terminals() as (ours, theirs):
            data = SimData(0, values=[100, 101, 102], datatype=DataType.REGISTERS)
            server = ModbusSerialServer(SimDevice(1, simdata=[data]), port=theirs, baudrate=115_200)
            await server.serve_forever(background=True)
            try:
                readings = await take(make_source(ours, [2, 0, 1]), 20)
            finally:
                await server.shutdown()  # type: ignore[no-untyped-call]  # pymodbus leaves it without annotations
        assert {reading.counts for reading in readings} == {(102, 100, 101)}

    asyncio.run(story())


def test_a_probe_has_a_length_that_no_reading_has() -> None:
    assert probe_of([Block(4, 3)]) == Block(4, 1)
    assert probe_of([Block(0, 1), Block(4, 3)]) == Block(4, 2)
    assert probe_of([Block(4, 1)]) is None
    assert probe_of([Block(0, 1), Block(4, 2)]) is None


@pytest.mark.parametrize("late_s", [0.08, 0.2, 0.5], ids=["just", "after reopening", "long"])
def test_a_late_answer_is_never_taken_for_a_later_one(late_s: float) -> None:
    readings, errors, age_s = run_with(lambda number, frame: [(late_s if number % 20 == 10 else 0.0, frame)], 40)
    assert len(readings) >= 40
    assert len(errors) >= 2
    assert age_s < 0.05  # a late answer is at least a timeout older


def test_a_late_answer_is_waited_for_where_nothing_tells_it_from_a_later_one() -> None:
    readings, errors, age_s = run_with(lambda number, frame: [(0.5 if number == 10 else 0.0, frame)], 20, [7])
    assert len(readings) >= 20
    assert len(errors) == 1
    assert age_s < 0.05


@pytest.mark.parametrize(
    "damage",
    [
        lambda _: b"",
        lambda frame: frame[:-3],
        lambda frame: frame[:4] + b"\xff" + frame[5:],
        lambda frame: frame + b"\0",
    ],
    ids=["lost", "truncated", "flipped", "with noise behind it"],
)
def test_a_damaged_answer_costs_a_reading_at_most(damage: Callable[[bytes], bytes]) -> None:
    readings, errors, age_s = run_with(lambda number, frame: [(0.0, damage(frame) if number == 10 else frame)], 20)
    assert len(readings) >= 20
    assert len(errors) <= 1
    assert age_s < 0.05
    assert not errors or errors == ["unit 1 does not answer within 60 ms"]


def test_a_doubled_answer_is_noticed_before_the_next_request() -> None:
    _, errors, age_s = run_with(lambda number, frame: [(0.0, frame), (0.003, frame if number == 10 else b"")], 20)
    assert errors == ["unit 1 sent an answer that was not asked for"]
    assert age_s < 0.05


def test_a_port_in_use_is_an_error_that_says_so() -> None:
    async def story() -> None:
        with terminal() as line:
            async with rtu_unit(line, StampingUnit()):
                stream = make_source(line.path, [0, 1]).readings()
                await anext(stream)
                with pytest.raises(SourceError, match="does no other program use it"):
                    await take(make_source(line.path, [0, 1]), 1)
                await stream.aclose()

    asyncio.run(story())


def test_an_unplugged_port_is_an_error() -> None:
    async def story() -> None:
        with terminal() as line:
            async with rtu_unit(line, StampingUnit()):
                stream = make_source(line.path, [0, 1]).readings()
                await anext(stream)
                line.unplug()
                with pytest.raises(SourceError):
                    await asyncio.wait_for(anext(stream), 2)

    asyncio.run(story())
