"""Polls slot by slot, on a clock of the test: when units are asked, what is lost, and who is given up."""

import asyncio
from collections.abc import AsyncGenerator, Callable
from contextlib import AbstractAsyncContextManager, AbstractContextManager, aclosing, nullcontext

import pytest

from beamtouch_daemon.sources import polled
from beamtouch_daemon.sources import reading as timed
from beamtouch_daemon.sources.polled import Part, PolledSource
from beamtouch_daemon.sources.reading import NoAnswerError, Reading, SourceError
from beamtouch_daemon.sources.registers import Block, RegisterAnswer, Value
from beamtouch_daemon.sources.requests import Requests

pytestmark = pytest.mark.anyio

BEGUN_S, SLOT_S = 1000.0, 0.125
QUICK_S = 0.015625
"""Time of an answer."""


class Clock:
    """A time that goes on as it is waited for."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now_s = BEGUN_S
        pause = asyncio.sleep

        async def sleep(pause_s: float) -> None:
            self.now_s += pause_s
            await pause(0)

        for module in (polled, timed):
            monkeypatch.setattr(module, "uptime_s", lambda: self.now_s)
        monkeypatch.setattr(asyncio, "sleep", sleep)


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    return Clock(monkeypatch)


class Unit:
    """A unit that answers its request number n, from 1, after so long, or not at all: `answer` says both."""

    rest_s = 1.0
    limits: tuple[str, ...] = ("Old ones pass.",)

    def __init__(self, clock: Clock, answer: Callable[[int], tuple[float, bool]], number: int = 3) -> None:
        self.name, self.observed = f"unit {number}", f"{number} bytes came"
        self.requests = Requests()
        self.boots_until_s = 0.0
        self.asked_s = list[float]()
        """Times of the requests, since the begin."""
        self._clock, self._answer = clock, answer

    def opened(self) -> AbstractAsyncContextManager[None]:
        return nullcontext()

    def kept_open(self) -> AbstractContextManager[None]:
        return nullcontext()

    async def read(self, block: Block) -> RegisterAnswer:
        asked_s = self._clock.now_s
        self.asked_s.append(asked_s - BEGUN_S)
        took_s, is_given = self._answer(len(self.asked_s))
        self._clock.now_s += took_s
        if not is_given:
            raise NoAnswerError(f"{self.name} does not answer")
        return RegisterAnswer([100 + len(self.asked_s)] * block.count, asked_s=asked_s)


def source(*units: Unit) -> PolledSource:
    parts = [Part(unit, [Block(4, 1)], {index: Value(4)}) for index, unit in enumerate(units)]
    return PolledSource("bench", parts, len(units), 1 / SLOT_S)


async def taken(stream: AsyncGenerator[list[Reading], None], number: int) -> list[Reading]:
    return [reading for _ in range(number) for reading in await anext(stream)]


def quick(_number: int) -> tuple[float, bool]:
    return QUICK_S, True


async def test_a_unit_is_asked_in_each_slot_from_its_first_answer_on(clock: Clock) -> None:
    unit = Unit(clock, lambda number: (0.5 if number == 1 else QUICK_S, True))
    async with aclosing(source(unit).readings()) as stream:
        readings = await taken(stream, 5)
    assert unit.asked_s == [0.0, 0.5, 0.625, 0.75, 0.875]  # slots begin with the first reading, and the next is due
    assert [reading.counts for reading in readings] == [(101,), (102,), (103,), (104,), (105,)]
    assert [reading.monotonic_s - BEGUN_S for reading in readings] == unit.asked_s
    assert [(reading.lost, reading.failed) for reading in readings] == [(0, 0), (3, 0), (0, 0), (0, 0), (0, 0)]
    assert readings[4].likely_s - readings[4].monotonic_s == QUICK_S / 2


@pytest.mark.parametrize(
    ("answer", "lost", "failed"),
    [
        (lambda number: (0.4 if number == 3 else QUICK_S, True), [0, 0, 0, 2, 0], [0, 0, 0, 0, 0]),
        (lambda number: (QUICK_S, number != 3), [0, 0, 1, 0, 0], [0, 0, 1, 0, 0]),
        (lambda number: (QUICK_S, number not in (3, 4)), [0, 0, 2, 0, 0], [0, 0, 2, 0, 0]),
        # A request that fails may take many slots.
        (lambda number: (0.4 if number == 3 else QUICK_S, number != 3), [0, 0, 3, 0, 0], [0, 0, 3, 0, 0]),
    ],
    ids=["slow", "one missing", "two missing", "a long timeout"],
)
async def test_slots_without_a_reading_are_lost_and_those_that_failed_are_told_apart(
    clock: Clock, answer: Callable[[int], tuple[float, bool]], lost: list[int], failed: list[int]
) -> None:
    async with aclosing(source(Unit(clock, answer)).readings()) as stream:
        readings = await taken(stream, 5)
    assert ([reading.lost for reading in readings], [reading.failed for reading in readings]) == (lost, failed)


async def test_a_session_ends_once_all_units_are_given_up_and_the_next_one_waits_for_their_rest(clock: Clock) -> None:
    first = Unit(clock, lambda number: (QUICK_S, number < 3), 3)
    second = Unit(clock, lambda number: (QUICK_S, number < 4), 4)
    both = source(first, second)
    stream = both.readings()
    await taken(stream, 3)
    with pytest.raises(SourceError) as raised:
        await taken(stream, 9)
    assert raised.value.reason == "unit 3 does not answer; unit 4 does not answer"
    assert raised.value.observed == "3 bytes came; 4 bytes came"
    assert both.limits == ("Old ones pass.",)
    ended_s, asked = clock.now_s - BEGUN_S, len(first.asked_s)
    with pytest.raises(SourceError):
        await taken(both.readings(), 1)
    assert len(first.asked_s) == asked + 1  # a unit that is tried again is given up at once
    assert ended_s + 0.5 < first.asked_s[-1] <= ended_s + 1.0


async def test_a_unit_that_is_given_up_costs_the_others_nothing_and_is_tried_again(
    clock: Clock, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("INFO")
    unit = Unit(clock, quick, 3)
    away = Unit(clock, lambda number: (0.0, number < 3 or number > 6), 4)
    async with aclosing(source(unit, away).readings()) as stream:
        readings = await taken(stream, 40)
    assert [reading.counts[0] for reading in readings] == [101 + number for number in range(40)]
    assert {reading.lost for reading in readings} == {0}
    missing = [number for number, reading in enumerate(readings) if reading.counts[1] is None]
    assert missing == list(range(2, missing[-1] + 1))
    # It fails in slots 2, 3 and 4, and again when it was tried after a rest of a second.
    assert away.asked_s[2:5] == pytest.approx([0.25, 0.375, 0.5], abs=0.02)
    assert away.asked_s[5] == pytest.approx(1.625, abs=0.13)
    assert away.asked_s[6] == pytest.approx(2.75, abs=0.26)
    assert [line.partition(" after")[0] for line in caplog.messages] == [
        "bench: unit 4 does not answer; trying again",
        "bench: unit 4 works again",
    ]


async def test_the_links_are_kept_open_between_sessions_if_that_is_wanted(clock: Clock) -> None:
    opened = list[str]()

    class Kept(Unit):
        def kept_open(self) -> AbstractContextManager[None]:
            opened.append(self.name)
            return nullcontext()

    with source(Kept(clock, quick, 3), Kept(clock, quick, 4)).kept_open():
        assert opened == ["unit 3", "unit 4"]


async def test_a_unit_that_may_boot_keeps_the_session_alive(clock: Clock) -> None:
    unit = Unit(clock, lambda number: (QUICK_S, number > 4))
    unit.boots_until_s = BEGUN_S + 60.0
    async with aclosing(source(unit).readings()) as stream:
        (reading,) = await taken(stream, 1)
    # Outside the slots it is tried again after its rest; once it answers, it is asked in the next slot.
    assert unit.asked_s == pytest.approx([0.0, 1.125, 2.25, 3.375, 4.5, 4.5], abs=5 * SLOT_S)
    assert reading.monotonic_s - BEGUN_S == unit.asked_s[-1]
