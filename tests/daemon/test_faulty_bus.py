"""No pattern of faults on a Modbus RTU bus makes an old value of a new one: sessions, single registers, echoes."""

import asyncio
import json
from collections.abc import Callable
from pathlib import Path

import pytest

from beamtouch_daemon.sources.configured import Buses
from beamtouch_daemon.sources.reading import Reading

from . import configs
from .devices import NumberingUnit, Pieces, StampingUnit, rtu_units
from .faulty import plain
from .faulty_bus import Outcome, patterns, run, values_only
from .lines import terminal
from .process import command
from .sessions import source_in, take_across_sessions

pytestmark = pytest.mark.anyio

PATTERNS = patterns(seed=3)
SLOW = ("late, 0.2 %, answers only values", "late, 3 %, one register")
TRIES = 4
"""Requests to a unit before it is on."""
QUICK = [name for name, one in PATTERNS.items() if one.is_provable and one.sessions == 1 and name not in SLOW]


def table(path: str, timeout_ms: float = 100.0) -> str:
    return f'kind = "modbus-rtu"\nport = "{path}"\ntimeout_ms = {timeout_ms}'


def is_of(unit: NumberingUnit) -> Callable[[Reading], None]:
    """A check that a reading that has just come is that of the newest request."""

    def check(reading: Reading) -> None:
        assert set(reading.counts) == {unit.newest}

    return check


@pytest.mark.parametrize("name", QUICK)
async def test_no_value_is_stale_or_foreign(name: str) -> None:
    outcome: Outcome = await asyncio.wait_for(run(PATTERNS[name], 40, seed=3, answers=25), 120)
    assert (outcome.stale, outcome.foreign) == (0, 0)


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
            for _ in range(6):
                source = source_in(buses, table(line.path, 2000.0), ["register = 0", "register = 1"], 50.0)
                stream = source.readings()
                for _ in range(3):
                    is_of(unit)((await anext(stream))[0])
                owing = asyncio.ensure_future(anext(stream))
                requests.clear()
                await requests.wait()
                owing.cancel()
                await asyncio.gather(owing, return_exceptions=True)
                await stream.aclose()
                buses = {} if is_killed else buses


@pytest.mark.parametrize("kind", ["answers other requests", "answers only values"])
async def test_a_single_register_that_comes_1500_ms_late_is_not_believed(kind: str) -> None:
    def late(number: int, frame: bytes) -> Pieces:
        return [(1.5 if number == 20 else 0.0, frame)]

    with terminal() as line:
        unit = NumberingUnit(values_only(late) if kind == "answers only values" else late)
        async with rtu_units(line, {1: unit}):
            source = source_in({}, table(line.path), ["register = 7"], 50.0)
            await take_across_sessions(source, 60, is_of(unit))
        number = sum("left alone for 5 s" in limit for limit in source.limits)
    assert number == (kind == "answers only values")


async def test_a_unit_with_one_probe_that_was_off_at_the_start_is_read_once_it_is_on() -> None:
    is_on = False
    requests = asyncio.Semaphore(0)

    def one_probe(_number: int, frame: bytes) -> Pieces:
        requests.release()
        return [(0.0, frame)] if is_on and frame[1:3] in {b"\4\2", b"\4\4"} else []

    with terminal() as line:
        unit = NumberingUnit(one_probe)
        async with rtu_units(line, {1: unit}):
            source = source_in({}, table(line.path), ["register = 0", "register = 1"], 50.0)
            reading = asyncio.create_task(take_across_sessions(source, 40, is_of(unit)))
            for _ in range(TRIES):
                await requests.acquire()
            is_on = True
            await reading


async def test_check_states_what_cannot_be_proven_of_a_unit(tmp_path: Path) -> None:
    with terminal() as line:
        async with rtu_units(line, {1: StampingUnit(values_only(lambda _number, frame: [(0.0, frame)]))}):
            config = configs.write(tmp_path, plain(configs.rtu(line.path)).replace("register = 1", "register = 9"))
            outcome = await command("check", config, "--json")
    limits = json.loads(outcome.out)["surfaces"]["bench"]["limits"]
    assert [limit for limit in limits if limit.startswith("unit 1 answers only requests for its values")]
    assert [limit for limit in limits if "left alone for 5 s" in limit]
    assert [limit for limit in limits if "another master" in limit]


@pytest.mark.parametrize("registers", [1, 2])
async def test_an_adapter_that_echoes_costs_no_unit(registers: int) -> None:
    with terminal() as line:
        unit = NumberingUnit(lambda number, frame: [] if number == 10 else [(0.02, frame)])
        async with rtu_units(line, {1: unit}, echo=lambda request: [(0.0, request)]):
            places = [f"register = {index}" for index in range(registers)]
            source = source_in({}, table(line.path, 500.0), places, 20.0)
            async with asyncio.timeout(60):
                _, errors = await take_across_sessions(source, 40, is_of(unit))
    assert errors == []
