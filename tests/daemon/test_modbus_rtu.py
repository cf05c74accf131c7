"""Modbus RTU over pseudo-terminals: no fault of a bus makes an old value of a new one, and none stops the others."""

import asyncio
import itertools
import json
from collections.abc import AsyncIterator, Callable
from functools import partial
from pathlib import Path
from time import monotonic

import pytest

from beamtouch_daemon.sources.registers import Block
from beamtouch_daemon.sources.rtu_unit import probes_for
from beamtouch_daemon.tasks import cancel
from support.surfaces import configs

from .devices import Fault, NumberingUnit, Pieces, StampingUnit, no_echo, rtu_units, with_crc
from .faulty import plain
from .faulty_bus import Pattern, patterns, run, values_only
from .lines import terminal
from .process import command
from .sessions import Buses, Reading, Source, SourceError, change_waits, source_in, take_across_sessions
from .waits import until

pytestmark = pytest.mark.anyio

PATTERNS = patterns(seed=3)
PROVABLE = {name: one for name, one in PATTERNS.items() if one.is_provable}
READ = 4
PLACES = [f"register = {index}" for index in range(3)]
LATEST_S = 2.0
"""In place of the 5 s of the daemon: no answer here is later."""
VALUES = bytes([READ, 2 * len(PLACES)])
"""Function and length of an answer with the values of these places."""


def table(path: str, unit: int = 1, timeout_ms: float = 2000.0) -> str:
    return f'kind = "modbus-rtu"\nport = "{path}"\ntimeout_ms = {timeout_ms}\nunit = {unit}'


def of(*units: NumberingUnit) -> Callable[[Reading], None]:
    """A check that the values of a reading that has just come are those that its units gave last; one per channel."""

    def check(reading: Reading) -> None:
        for count, unit in zip(reading.counts, units, strict=True):
            assert count is None or count == unit.newest

    return check


async def read_through(
    fault: Fault,
    number: int,
    *,
    places: list[str] = PLACES,
    timeout_ms: float = 2000.0,
    rate_hz: float = 50.0,
    echo: Callable[[bytes], Pieces] = no_echo,
) -> tuple[list[Reading], list[str], Source]:
    """Read a unit with a fault so often; return readings, errors and the source. No value may be an older one."""
    with terminal() as line:
        unit = NumberingUnit(fault)
        async with rtu_units(line, {1: unit}, echo=echo):
            source = source_in({}, table(line.path, timeout_ms=timeout_ms), places, rate_hz)
            return *(await take_across_sessions(source, number, of(*[unit] * len(places)))), source


async def assert_no_value_is_stale_or_foreign(pattern: Pattern, polls: int, monkeypatch: pytest.MonkeyPatch) -> None:
    change_waits(monkeypatch, forgotten_s=LATEST_S)
    outcome = await asyncio.wait_for(run(pattern, polls, seed=3, answers=25), 240)
    assert (outcome.stale, outcome.foreign) == (0, 0)


@pytest.mark.parametrize("name", [name for name, one in PROVABLE.items() if one.is_quick])
async def test_no_value_is_stale_or_foreign(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    await assert_no_value_is_stale_or_foreign(PROVABLE[name], 40, monkeypatch)


@pytest.mark.soak
@pytest.mark.parametrize("name", [name for name, one in PROVABLE.items() if not one.is_quick])
async def test_no_value_is_stale_or_foreign_in_many_polls(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    await assert_no_value_is_stale_or_foreign(PROVABLE[name], 400, monkeypatch)


@pytest.mark.parametrize("registers", [1, 3])
@pytest.mark.parametrize("echoes", [False, True])
async def test_damage_costs_its_readings_and_not_the_session(registers: int, *, echoes: bool) -> None:
    damages: dict[int, Callable[[bytes], bytes]] = {
        10: lambda _: b"",
        14: lambda frame: frame[:-3],
        18: lambda frame: frame[:4] + bytes([frame[4] ^ 0x55]) + frame[5:],
        22: lambda frame: b"\0\xff" + frame + b"\0",
        26: lambda frame: frame[:-1] + bytes([frame[-1] ^ 1]),
    }

    def damage(number: int, frame: bytes) -> Pieces:
        return [(0.0, damages.get(number, bytes)(frame))]

    places, echo = PLACES[:registers], (lambda request: [(0.0, request)]) if echoes else no_echo
    _, errors, _ = await read_through(damage, 30, places=places, timeout_ms=500.0, echo=echo)
    assert errors == []


@pytest.mark.parametrize("is_killed", [False, True], ids=["goes on", "killed"])
async def test_a_session_that_begins_while_an_answer_is_owed_gives_no_old_value(*, is_killed: bool) -> None:
    with terminal() as line:
        requests = asyncio.Event()

        def slow(_number: int, frame: bytes) -> Pieces:
            requests.set()
            return [(0.03, frame)]

        unit = NumberingUnit(slow)
        async with rtu_units(line, {1: unit}):
            buses: Buses = {}
            for _ in range(4):
                stream = source_in(buses, table(line.path), PLACES[:2], 50.0).readings()
                for _ in range(3):
                    of(unit, unit)((await anext(stream))[0])
                owing = asyncio.ensure_future(anext(stream))
                requests.clear()
                await requests.wait()
                await cancel([owing])
                await stream.aclose()
                buses = {} if is_killed else buses


@pytest.mark.parametrize("kind", ["answers other requests", "answers only values"])
async def test_a_single_register_that_comes_1500_ms_late_is_not_believed(
    kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    change_waits(monkeypatch, forgotten_s=LATEST_S)

    def late(number: int, frame: bytes) -> Pieces:
        return [(1.5 if number == 20 else 0.0, frame)]

    fault = values_only(late) if kind == "answers only values" else late
    _, _, source = await read_through(fault, 60, places=["register = 7"], timeout_ms=100.0)
    number = sum(f"not polled for {LATEST_S:g} s" in limit for limit in source.limits)
    assert number == (kind == "answers only values")


async def test_a_unit_with_one_probe_that_was_off_at_the_start_is_read_once_it_is_on(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    change_waits(monkeypatch, forgotten_s=LATEST_S)
    is_on = False
    requests = asyncio.Semaphore(0)

    def one_probe(_number: int, frame: bytes) -> Pieces:
        requests.release()
        return [(0.0, frame)] if is_on and frame[1:3] in {b"\4\2", b"\4\4"} else []

    with terminal() as line:
        unit = NumberingUnit(one_probe)
        async with rtu_units(line, {1: unit}):
            source = source_in({}, table(line.path, timeout_ms=100.0), PLACES[:2], 50.0)
            reading = asyncio.create_task(take_across_sessions(source, 40, of(unit, unit)))
            for _ in range(4):
                await requests.acquire()
            is_on = True
            await reading


async def test_the_late_answer_to_a_repeated_probe_proves_nothing_of_what_was_asked_since() -> None:
    asked: list[bytes] = []
    timeout_s, repeated = 0.2, 0

    def late(_number: int, frame: bytes) -> Pieces:
        nonlocal repeated
        kind = frame[1:3]
        is_repeated = kind != VALUES and asked[-1:] == [kind]
        asked.append(kind)
        repeated += is_repeated
        # The answer to each tenth value comes during the second try of a probe; that try is then answered late as well.
        if kind == VALUES and asked.count(VALUES) % 10 == 0:
            return [(2.5 * timeout_s, frame)]
        return [(1.5 * timeout_s if is_repeated else 0.0, frame)]

    await read_through(late, 25, timeout_ms=timeout_s * 1e3, rate_hz=200.0)
    assert repeated >= 2


async def test_copies_of_answers_are_not_believed_once_one_was_noticed() -> None:
    held: list[bytes] = []
    values = late_copies = 0

    def copying(_number: int, frame: bytes) -> Pieces:
        nonlocal values, late_copies
        pieces = [(0.0, held.pop()), (0.003, frame)] if held else [(0.0, frame)]
        late_copies += len(pieces) - 1
        values += frame[1:3] == VALUES
        if frame[1:3] == VALUES and values % 10 == 0:
            held.append(frame)  # this copy comes with the answer to the next request
        elif frame[1:3] == VALUES:
            # The first copies come right behind their answers, so that they are noticed on a busy machine, too.
            pieces.append((0.0 if values < 5 else 0.002, frame))
        return pieces

    await read_through(copying, 60, timeout_ms=300.0, rate_hz=200.0)
    assert late_copies >= 3


@pytest.mark.parametrize("blocks", [[Block(4, 3)], [Block(0, 1), Block(4, 3)], [Block(4, 1)], [Block(0, 125)]])
def test_no_probe_is_answered_as_a_value_is_and_there_are_several(blocks: list[Block]) -> None:
    probes = probes_for(blocks)
    lengths = {block.count for block in blocks}
    assert len(probes) >= 3
    assert not [probe for probe in probes if probe.function == READ and probe.count in lengths]


async def test_each_start_asks_its_probes_in_another_order() -> None:
    orders = set[tuple[bytes, ...]]()
    for _ in range(5):
        asked: list[bytes] = []

        def note(_number: int, frame: bytes, asked: list[bytes] = asked) -> Pieces:
            asked.append(frame[1:3])
            return [(0.0, frame)]

        await read_through(note, 1, timeout_ms=100.0)
        orders.add(tuple(kind for kind in asked if kind != VALUES)[:2])
    assert len(orders) > 1  # among twenty orders of two probes


async def test_a_unit_that_was_replaced_by_one_without_these_probes_is_read_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    change_waits(monkeypatch, forgotten_s=0.5, learn_again_s=0.5)
    values = 0

    def replaced(_number: int, frame: bytes) -> Pieces:
        nonlocal values
        values += frame[1:3] == VALUES
        return [(0.0, frame)] if values < 10 or (frame[1:3] == VALUES and values > 10) else []

    await read_through(replaced, 30, timeout_ms=50.0)


@pytest.mark.promise(
    "docs/how-to/adc-module.md",
    "it also lists the cases in which the bus may deliver an old value unnoticed.",
)
async def test_check_states_what_cannot_be_proven_of_a_unit(tmp_path: Path) -> None:
    with terminal() as line:
        async with rtu_units(line, {1: StampingUnit(values_only(lambda _number, frame: [(0.0, frame)]))}):
            config = configs.write(tmp_path, plain(configs.rtu(line.path)).replace("register = 1", "register = 9"))
            for _ in range(5):  # a starved machine may read nothing at once
                outcome = await command("check", config, "--json")
                if limits := json.loads(outcome.out)["surfaces"]["bench"]["limits"]:
                    break
    for words in ("unit 1 answers only requests for its values", "not polled for 5 s", "another master"):
        assert any(words in limit for limit in limits), outcome.out


async def test_an_answer_to_an_earlier_program_in_the_silence_of_a_start_is_followed_by_probes() -> None:
    sent: list[str] = []
    foreign = with_crc(bytes([1, READ, 2 * len(PLACES)]) + b"\xee" * 2 * len(PLACES))

    def late(_number: int, frame: bytes) -> Pieces:
        sent.append("value" if frame[1:3] == VALUES else "probe")
        if sent.count("probe") > 4 or sent[-1] == "value":
            return [(0.0, frame)]
        sent.append("foreign")
        return [(0.0, frame), (0.02, foreign)]

    readings, errors, _ = await read_through(late, 5, rate_hz=20.0)
    assert errors == []
    first = sent.index("value", 1)
    # Both probes are found, both prove, and both prove again after what came in the silence.
    assert sent[:first] == ["value", *["probe", "foreign"] * 4, "probe", "probe"]
    begin = first - sent[:first].count("foreign")
    assert [reading.counts for reading in readings] == [(begin + number,) * len(PLACES) for number in range(5)]


async def test_a_unit_of_which_other_registers_are_read_proves_again_that_it_owes_nothing() -> None:
    asked: list[bytes] = []

    def note(_number: int, frame: bytes) -> Pieces:
        asked.append(frame[1:3])
        return [(0.01, frame)]

    with terminal() as line:
        async with rtu_units(line, {1: NumberingUnit(note)}):
            buses: Buses = {}
            stream = source_in(buses, table(line.path), PLACES, 20.0).readings()
            await anext(stream)
            first = [kind for kind in asked if kind != VALUES]
            del asked[:]
            # Whatever was a probe so far may be as long as these values are, and its late answer looks like them.
            lengths = [kind[1] // 2 for kind in first if kind[0] == READ] or [len(PLACES) + 2]
            places = [f"register = {register}" for register in range(lengths[0])]
            other = asyncio.create_task(take_across_sessions(source_in(buses, table(line.path), places, 20.0), 3))
            while not other.done():
                await anext(stream)
            _, errors = await other
            await stream.aclose()
    other_values = bytes([READ, 2 * lengths[0]])
    begin = next(place for place, kind in enumerate(asked) if kind not in {VALUES, other_values})
    assert asked[:begin].count(other_values) <= 1  # a unit that answers anything answers this
    probes = asked[begin : begin + 4]
    assert not {VALUES, other_values} & set(probes)
    assert probes[:2] == probes[2:]  # two are found, and both prove
    assert errors == []


@pytest.mark.promise("docs/how-to/several-surfaces.md", "The daemon asks them in turn")
async def test_several_surfaces_and_several_units_that_owe_answers_share_a_bus() -> None:
    def late(number: int, frame: bytes) -> Pieces:
        return [(0.3 if number % 20 == 19 else 0.0, frame)]

    with terminal() as line:
        units = {1: NumberingUnit(late), 2: NumberingUnit(late), 3: NumberingUnit()}
        async with rtu_units(line, units):
            buses: Buses = {}
            places = ["register = 1", "register = 1\nunit = 2", "register = 2\nunit = 2"]
            one = source_in(buses, table(line.path, timeout_ms=200.0), places, 50.0)
            other = source_in(buses, table(line.path, 3, 200.0), PLACES[:2], 50.0)
            _, (readings, _) = await asyncio.gather(
                take_across_sessions(one, 60, of(units[1], units[2], units[2])),
                take_across_sessions(other, 60, of(units[3], units[3])),
            )
        assert len(buses) == 1
        assert all(None not in reading.counts for reading in readings)


async def test_an_answer_that_follows_a_refusal_is_as_old_as_the_request_that_was_refused() -> None:
    def refuse_first(number: int, frame: bytes) -> Pieces:
        refusal = with_crc(bytes([frame[0], frame[1] | 0x80, 11]))
        return [(0.0, refusal), (0.03, frame)] if number % 3 == 0 else [(0.0, frame)]

    with terminal() as line:
        unit = StampingUnit(refuse_first)
        async with rtu_units(line, {1: unit}):
            source = source_in({}, table(line.path), PLACES, 10.0)
            readings, errors = await take_across_sessions(source, 30)
    assert errors == []
    late = [unit.age_s(count, reading.monotonic_s) for reading in readings for count in reading.counts if count]
    assert max(late) < 0.002


class BackError(Exception):
    """A unit answers again."""


@pytest.mark.promise("docs/how-to/several-surfaces.md", "and a dead unit hardly slows the others.")
async def test_a_dead_unit_costs_other_units_under_a_tenth_and_returns_within_2_s() -> None:
    timeout_ms, rate_hz, seen = 100.0, 50.0, 0

    def see(reading: Reading) -> None:
        nonlocal seen
        seen += 1
        if reading.counts[2] is not None:
            raise BackError

    with terminal() as line:
        units, unanswered = {1: StampingUnit()}, list[int]()
        async with rtu_units(line, units, unanswered):
            places = [*PLACES[:2], "register = 0\nunit = 2"]
            source = source_in({}, table(line.path, timeout_ms=timeout_ms), places, rate_hz)
            await take_across_sessions(source, 1)
            unanswered.clear()
            begin_s = monotonic()
            readings, _ = await take_across_sessions(source, 200)
            took_s = monotonic() - begin_s
            assert {reading.counts[2] for reading in readings} == {None}
            assert 1 <= len(unanswered) < 0.1 * took_s / (timeout_ms / 1e3)  # of the bus' time
        units[2] = StampingUnit()
        async with rtu_units(line, units):
            seen = 0
            with pytest.raises(BackError):
                await take_across_sessions(source, 10_000, see)
            assert seen <= 2.0 * rate_hz + 1


@pytest.mark.parametrize("answers", ["nothing", "values only"])
async def test_other_units_are_read_after_each_timeout_of_a_unit_whose_probes_are_tried(answers: str) -> None:
    asked: list[int] = []

    def answer(unit: int, _number: int, frame: bytes) -> Pieces:
        asked.append(unit)
        return [(0.0, frame)] if unit == 1 or (answers == "values only" and frame[2] == 8) else []

    with terminal() as line:
        async with rtu_units(line, {unit: StampingUnit(partial(answer, unit)) for unit in (1, 2)}):
            buses: Buses = {}
            # So long that the first unit answers in time on a busy machine, too, and is never given up.
            one, two = (table(line.path, unit, 300.0) for unit in (1, 2))
            places = [f"register = {index}" for index in range(4)]
            tasks = [
                asyncio.create_task(take_across_sessions(source_in(buses, source, places, 50.0), 10_000))
                for source in (one, two)
            ]
            await until(lambda: asked.count(2) > (1 if answers == "nothing" else 4))
            await cancel(tasks)
    in_a_row = [len(list(group)) for unit, group in itertools.groupby(asked) if unit == 2]
    assert max(in_a_row) <= 2


async def until_it_ends(stream: AsyncIterator[list[Reading]]) -> None:
    async for _ in stream:
        pass


async def test_a_port_that_is_unplugged_while_a_dead_unit_is_tried_again_ends_the_session() -> None:
    unanswered: list[int] = []
    with terminal() as line:
        async with rtu_units(line, {1: StampingUnit()}, unanswered):
            places = [*PLACES, "register = 0\nunit = 2"]
            stream = source_in({}, table(line.path, timeout_ms=300.0), places, 20.0).readings()
            reads = asyncio.create_task(until_it_ends(stream))
            await until(lambda: len(unanswered) > 1)  # the first request gives the unit up, the second tries it again
            line.unplug()
            with pytest.raises(SourceError, match="is gone"):
                await reads
