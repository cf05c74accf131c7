"""Modbus RTU over pseudo-terminals: against pymodbus's own server, and against a unit with every fault of a bus."""

import asyncio
import itertools
from collections.abc import Callable
from time import monotonic

import pytest
from pymodbus.server import ModbusSerialServer
from pymodbus.simulator import DataType, SimData, SimDevice

from beamtouch_daemon.sources.configured import Buses
from beamtouch_daemon.sources.polled import PolledSource
from beamtouch_daemon.sources.reading import Reading, SourceError, first_readings
from beamtouch_daemon.sources.registers import Block
from beamtouch_daemon.sources.rtu_unit import probes_for
from beamtouch_daemon.tasks import cancel

from .devices import Fault, NumberingUnit, Pieces, StampingUnit, rtu_units, with_crc
from .lines import joined_terminals, terminal
from .sessions import polled, source_in, take_across_sessions

pytestmark = pytest.mark.anyio

TIMEOUT_MS = 60.0


def table(path: str, unit: int = 1, timeout_ms: float = TIMEOUT_MS) -> str:
    return f'kind = "modbus-rtu"\nport = "{path}"\ntimeout_ms = {timeout_ms}\nunit = {unit}'


def make_source(path: str, registers: list[int], timeout_ms: float = 2000.0) -> PolledSource:
    return polled(table(path, timeout_ms=timeout_ms), registers, 100.0)


async def run_with(
    fault: Fault, number: int, registers: list[int] | None = None, rate_hz: float = 100.0, timeout_ms: float = 2000.0
) -> tuple[list[Reading], list[str]]:
    """Return readings and errors, having seen that every value is that of the newest request, however late it comes."""

    with terminal() as line:
        unit = NumberingUnit(fault)
        source = polled(table(line.path, timeout_ms=timeout_ms), registers or [0, 1, 2], rate_hz)
        async with rtu_units(line, {1: unit}):
            return await take_across_sessions(source, number, lambda reading: check_newest(reading, [unit] * 3))


def check_newest(reading: Reading, units: list[NumberingUnit]) -> None:
    """See that the values of a reading that just came are those that its units gave last; a unit per channel."""
    for count, unit in zip(reading.counts, units, strict=False):
        assert count is None or count == unit.newest


def gaps_s(readings: list[Reading]) -> list[float]:
    return [later.monotonic_s - earlier.monotonic_s for earlier, later in itertools.pairwise(readings)]


async def test_registers_are_read_from_pymodbus_own_server() -> None:
    with joined_terminals() as (ours, theirs):
        data = SimData(0, values=[100, 101, 102], datatype=DataType.REGISTERS)
        server = ModbusSerialServer(SimDevice(1, simdata=[data]), port=theirs, baudrate=115_200)
        await server.serve_forever(background=True)
        try:
            readings = await first_readings(make_source(ours, [2, 0, 1]), 20)
        finally:
            await server.shutdown()  # type: ignore[no-untyped-call]  # pymodbus leaves it without annotations
    assert {reading.counts for reading in readings} == {(102, 100, 101)}


@pytest.mark.parametrize("blocks", [[Block(4, 3)], [Block(0, 1), Block(4, 3)], [Block(4, 1)], [Block(0, 125)]])
def test_no_probe_is_answered_as_a_value_is_and_there_are_several(blocks: list[Block]) -> None:
    probes = probes_for(blocks)
    lengths = {block.count for block in blocks}
    assert len(probes) >= 3
    assert not [probe for probe in probes if probe.function == 4 and probe.count in lengths]


async def test_a_request_is_the_example_of_a_modules_manual() -> None:
    sent = bytearray()
    with terminal() as line:
        line.on_data(sent.extend)
        with pytest.raises(SourceError, match="unit 1 does not answer within 60 ms"):
            await first_readings(make_source(line.path, list(range(8)), TIMEOUT_MS), 1)
    # Modbus over serial line has no full example; this frame is that of the Waveshare manual for its eight inputs.
    assert sent[:8] == bytes.fromhex("01 04 00 00 00 08 F1 CC")


async def test_an_answer_is_found_among_others_and_never_made_of_another() -> None:
    def among_others(_number: int, frame: bytes) -> Pieces:
        other_unit = with_crc(bytes([6]) + b"\x63" * (len(frame) - 3))
        other_length = with_crc(bytes([1, 4, 2, 9, 9]))
        damaged = frame[:4] + bytes([frame[4] ^ 0x55]) + frame[5:]
        return [(0.0, b"\x01\x04" + other_unit + damaged + other_length + frame + frame[:-1])]

    readings, errors = await run_with(among_others, 20)
    assert errors == []
    assert len(readings) == 20


@pytest.mark.parametrize("registers", [[0, 1, 2], [7]], ids=["a block", "one register"])
@pytest.mark.parametrize("late_s", [0.08, 0.2, 0.5], ids=["just", "after several slots", "long"])
async def test_a_late_answer_is_never_taken_for_a_later_one(late_s: float, registers: list[int]) -> None:
    readings, _ = await run_with(
        lambda number, frame: [(late_s if number % 20 == 10 else 0.0, frame)], 40, registers, timeout_ms=TIMEOUT_MS
    )
    assert sum(gap_s > TIMEOUT_MS / 1e3 for gap_s in gaps_s(readings)) >= 2


@pytest.mark.parametrize(
    "damage",
    [
        lambda _: b"",
        lambda frame: frame[:-3],
        lambda frame: frame[:4] + b"\xff" + frame[5:],
        lambda frame: frame + b"\0",
        lambda frame: b"\0\xff" + frame,
    ],
    ids=["lost", "truncated", "flipped", "with noise behind it", "with noise before it"],
)
async def test_a_damaged_answer_costs_its_reading_and_not_the_session(damage: Callable[[bytes], bytes]) -> None:
    readings, errors = await run_with(
        lambda number, frame: [(0.0, damage(frame) if number == 10 else frame)], 20, timeout_ms=500.0
    )
    assert errors == []
    assert len(readings) == 20


async def test_flipped_bits_in_one_of_ten_frames_give_no_wrong_value() -> None:
    def flip(number: int, frame: bytes) -> list[tuple[float, bytes]]:
        if number % 10 == 3:
            bit = number * 7919 % (8 * len(frame))
            flipped = bytearray(frame)
            flipped[bit // 8] ^= 1 << bit % 8
            frame = bytes(flipped)
        return [(0.0, frame)]

    readings, errors = await run_with(flip, 150, timeout_ms=200.0)
    assert errors == []
    assert all(len(set(reading.counts)) == 1 for reading in readings)  # the unit gives all registers the same value


async def test_a_doubled_answer_is_thrown_away() -> None:
    def double(number: int, frame: bytes) -> list[tuple[float, bytes]]:
        return [(0.0, frame), (0.003, frame if number % 5 == 0 else b"")]

    # The copy comes 3 ms later, the next request after a tenth of a second: in this order on a busy machine too.
    readings, errors = await run_with(double, 30, rate_hz=10.0)
    assert errors == []
    assert len(readings) == 30


async def test_a_refusal_is_an_error_that_says_so() -> None:
    def refuse(number: int, frame: bytes) -> Pieces:
        return [(0.0, with_crc(bytes([1, 0x84, 2])) if 5 < number < 12 else frame)]

    _, errors = await run_with(refuse, 20, timeout_ms=TIMEOUT_MS)
    # On a busy machine, an answer may also be late.
    (error,) = {error for error in errors if "exception" in error}
    assert error.startswith("unit 1 answers with exception 2: it has no such register: asked for 0 to 2; addresses")


async def test_several_surfaces_and_several_units_share_a_bus() -> None:
    def check_odd(reading: Reading, units: dict[int, NumberingUnit]) -> None:
        # Unit 1 gives its two registers with two requests.
        assert (reading.counts[2], reading.counts[1]) == (units[1].newest, units[2].newest)
        assert reading.counts[0] == units[1].newest - 1

    with terminal() as line:
        units = {address: NumberingUnit() for address in (1, 2, 3)}
        async with rtu_units(line, units):
            buses: Buses = {}
            places = ["register = 0", "register = 1\nunit = 2", "register = 2"]
            one = source_in(buses, table(line.path, timeout_ms=2000.0), places, 50.0)
            other = source_in(buses, table(line.path, 3, 2000.0), ["register = 0", "register = 1"], 50.0)
            both = await asyncio.gather(
                take_across_sessions(one, 100, lambda reading: check_odd(reading, units)),
                take_across_sessions(other, 100, lambda reading: check_newest(reading, [units[3]] * 2)),
            )
        assert len(buses) == 1
        for readings, errors in both:
            assert errors == []
            assert all(None not in reading.counts for reading in readings)


class BackError(Exception):
    """A unit answers again."""


async def test_a_dead_unit_costs_other_units_under_a_tenth_and_returns_within_2_s() -> None:
    timeout_ms, rate_hz = 100.0, 50.0
    seen = 0

    def see(reading: Reading) -> None:
        nonlocal seen
        seen += 1
        if reading.counts[2] is not None:
            raise BackError

    with terminal() as line:
        units, unanswered = {1: StampingUnit()}, list[int]()
        async with rtu_units(line, units, unanswered):
            places = ["register = 0", "register = 1", "register = 0\nunit = 2"]
            source = source_in({}, table(line.path, timeout_ms=timeout_ms), places, rate_hz)
            await take_across_sessions(source, 1)
            unanswered.clear()
            begin_s = monotonic()
            readings, _ = await take_across_sessions(source, 200)
            took_s = monotonic() - begin_s
            assert {reading.counts[2] for reading in readings} == {None}
            assert len(unanswered) >= 1
            assert len(unanswered) * timeout_ms / 1e3 < 0.1 * took_s  # of the bus' time
        units[2] = StampingUnit()
        async with rtu_units(line, units):
            seen = 0
            with pytest.raises(BackError):
                await take_across_sessions(source, 10_000, see)
            assert seen <= 2.0 * rate_hz + 1


@pytest.mark.parametrize("answers", ["nothing", "values only"])
async def test_other_units_are_read_after_each_timeout_of_a_unit_whose_probes_are_tried(answers: str) -> None:
    asked: list[int] = []

    def live(_number: int, frame: bytes) -> Pieces:
        asked.append(1)
        return [(0.0, frame)]

    def odd(_number: int, frame: bytes) -> Pieces:
        asked.append(2)
        return [(0.0, frame)] if answers == "values only" and frame[2] == 8 else []

    with terminal() as line:
        async with rtu_units(line, {1: StampingUnit(live), 2: StampingUnit(odd)}):
            buses: Buses = {}
            fine = source_in(buses, table(line.path), [f"register = {index}" for index in range(4)], 50.0)
            places = [f"register = {index}\nunit = 2" for index in range(4)]
            other = asyncio.create_task(take_across_sessions(source_in(buses, table(line.path), places, 50.0), 1))
            await take_across_sessions(fine, 100)
            await cancel([other])
    in_a_row = [len(list(group)) for unit, group in itertools.groupby(asked) if unit == 2]
    assert in_a_row
    assert max(in_a_row) <= 2


async def test_units_that_owe_answers_never_confuse_each_other() -> None:
    with terminal() as line:
        units = {
            address: NumberingUnit(lambda number, frame: [(0.09 if number % 7 == 3 else 0.0, frame)])
            for address in (1, 2)
        }
        async with rtu_units(line, units):
            places = [f"register = {register}\nunit = {unit}" for unit in (1, 2) for register in (0, 1)]
            owners = [units[1], units[1], units[2], units[2]]
            await take_across_sessions(
                source_in({}, table(line.path), places, 50.0), 60, lambda reading: check_newest(reading, owners)
            )


async def test_a_port_in_use_is_an_error_that_says_so() -> None:
    with terminal() as line:
        async with rtu_units(line, {1: StampingUnit()}):
            stream = make_source(line.path, [0, 1]).readings()
            await anext(stream)
            with pytest.raises(SourceError, match="another program uses it: stop that one"):
                await first_readings(make_source(line.path, [0, 1]), 1)
            await stream.aclose()


async def test_an_unplugged_port_is_an_error() -> None:
    with terminal() as line:
        async with rtu_units(line, {1: StampingUnit()}):
            stream = make_source(line.path, [0, 1]).readings()
            await anext(stream)
            line.unplug()
            with pytest.raises(SourceError):
                await asyncio.wait_for(anext(stream), 60)
