"""How many answers from the record are under way at once, and how a reader leaves the interpreter to others."""

import asyncio
import threading
from collections.abc import Iterator
from contextlib import AsyncExitStack, closing
from functools import partial
from types import SimpleNamespace

import pytest
from sqlalchemy import literal, select, union_all

from beamtouch_service.record.database.errors import RecordAwayError
from beamtouch_service.record.reading import readers
from beamtouch_service.record.reading.readers import Reader, Readers, TooManyReadersError
from beamtouch_service.record.writing.transactions import Transactions
from beamtouch_service.sections import EventsSection

pytestmark = pytest.mark.anyio


@pytest.fixture
def transactions() -> Iterator[Transactions]:
    with closing(Transactions(EventsSection())) as opened:
        yield opened


async def test_32_answers_may_be_under_way_and_the_next_waits_for_a_while(
    transactions: Transactions, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert (readers.MAX_ANSWERS, readers.SLOT_S, readers.QUERY_S) == (32, 1.0, 15.0)
    monkeypatch.setattr(readers, "SLOT_S", 0.05)
    all_readers = Readers(transactions.database)
    async with AsyncExitStack() as slots:
        for _ in range(32):
            await slots.enter_async_context(all_readers.slot())
        with pytest.raises(TooManyReadersError):
            await slots.enter_async_context(all_readers.slot())
    # What ended in an error left its slot, too.
    for _ in range(33):
        with pytest.raises(ValueError, match="broken"):
            async with all_readers.slot():
                raise ValueError("broken")
    all_readers.end()


async def test_an_answer_of_the_database_is_awaited_for_a_time_only(
    transactions: Transactions, monkeypatch: pytest.MonkeyPatch
) -> None:
    all_readers, go_on = Readers(transactions.database), threading.Event()
    assert await all_readers.read(lambda reader: len(reader.rows(select(literal(1))))) == 1
    monkeypatch.setattr(readers, "QUERY_S", 0.05)
    with pytest.raises(RecordAwayError, match=r"^it has not answered for 0\.05 s$"):
        await all_readers.read(lambda _: go_on.wait(30))
    go_on.set()
    await asyncio.sleep(0)
    all_readers.end()


async def test_parts_of_an_answer_are_made_when_they_are_taken_and_answers_take_turns(
    transactions: Transactions,
) -> None:
    made = list[str]()

    def query(_: Reader, name: str) -> Iterator[str]:
        for number in range(3):
            made.append(f"{name}{number}")
            yield made[-1]

    all_readers = Readers(transactions.database)
    one, other = (all_readers.read_parts(partial(query, name=name)) for name in "ab")
    taken = [await anext(one), await anext(other), await anext(one)]
    assert taken == made == ["a0", "b0", "a1"]
    assert [part async for part in other] + [part async for part in one] == ["b1", "b2", "a2"]
    all_readers.end()


async def test_a_part_that_cannot_be_made_ends_its_answer_only(transactions: Transactions) -> None:
    def query(_: Reader) -> Iterator[int]:
        yield 1
        raise RecordAwayError("no route")

    all_readers = Readers(transactions.database)
    parts = all_readers.read_parts(query)
    assert await anext(parts) == 1
    with pytest.raises(RecordAwayError, match=r"^no route$"):
        await anext(parts)
    assert await all_readers.read(lambda reader: len(reader.rows(select(literal(1))))) == 1
    all_readers.end()


class Worked:
    """A clock, and the rests of its reader."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, step_s: float = 0.0) -> None:
        self.now_s, self._step_s, self.rests_s = 0.0, step_s, list[float]()
        monkeypatch.setattr(readers, "time", SimpleNamespace(perf_counter=self._read))
        monkeypatch.setattr(readers, "select", lambda *arguments: self.rests_s.append(arguments[-1]))

    def _read(self) -> float:
        self.now_s += self._step_s
        return self.now_s


@pytest.mark.parametrize(("answers", "times"), [(1, 2.0), (2, 4.0), (5, 10.0), (32, 10.0)])
async def test_a_reader_that_worked_for_a_fifth_of_a_millisecond_rests_the_longer_the_more_answers_are_under_way(
    transactions: Transactions, monkeypatch: pytest.MonkeyPatch, answers: int, times: float
) -> None:
    worked, all_readers = Worked(monkeypatch), Readers(transactions.database)

    def work(reader: Reader) -> None:
        for now_s in (0.199e-3, 0.2e-3, 0.399e-3, 0.5e-3):
            worked.now_s = now_s
            reader.rest()

    async with AsyncExitStack() as slots:
        for _ in range(answers):
            await slots.enter_async_context(all_readers.slot())
        await all_readers.read(work)
    all_readers.end()
    assert worked.rests_s == pytest.approx([times * 0.2e-3, times * 0.3e-3])


def test_a_reader_that_was_put_aside_while_it_worked_rests_a_tenth_of_a_second_at_most(
    transactions: Transactions, monkeypatch: pytest.MonkeyPatch
) -> None:
    worked = Worked(monkeypatch)
    reader = Reader(transactions.database, lambda: 32)
    for now_s in (0.009, 0.029):
        worked.now_s = now_s
        reader.rest()
    assert worked.rests_s == pytest.approx([0.09, 0.1])


@pytest.mark.parametrize(("count", "rests"), [(8, 1), (9, 2), (16, 2), (17, 3)])
def test_a_reader_rests_after_each_eight_rows(
    transactions: Transactions, monkeypatch: pytest.MonkeyPatch, count: int, rests: int
) -> None:
    worked = Worked(monkeypatch, step_s=1.0)
    numbers = union_all(*[select(literal(number)) for number in range(count)]).subquery()
    rows = Reader(transactions.database).rows(select(numbers))
    assert [row[0] for row in rows] == list(range(count))
    assert len(worked.rests_s) == rests
