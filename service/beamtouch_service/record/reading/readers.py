"""Readers of the record: two threads, a bounded number of answers, and never the interpreter for long.

A reader may take long, an answer to `GET /contact` may not, and both need the interpreter. So a reader works for a
fraction of a millisecond at a time, and rests for several times as long: the more answers are under way, the longer.
"""

import asyncio
import time
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager, suppress
from select import select
from typing import Any, TypeVar

from sqlalchemy import Row, Select

from beamtouch_common.threads import Workers
from beamtouch_service.record.database.connections import READERS, Database
from beamtouch_service.record.database.errors import RecordAwayError

MAX_ANSWERS = 32
"""Answers from the record that may be under way: waiting for a thread, being read, or being sent."""
SLOT_S = 1.0
"""A request waits this long for a slot among them. A client that asks again at once is so slowed down, too."""
QUERY_S = 15.0
"""Longest time for an answer of the database."""
_WORK_S = 0.2e-3
"""Longest time that a reader works at a time [s], but for what one row takes."""
_REST, _MOST_REST = 2.0, 10.0
"""Then it rests for this many times as long for each answer that is under way, at most for as many times as the second
says. A single answer costs a contact little, and 200 000 events take minutes; many of them would hold it up."""
_LONGEST_REST_S = 0.1
"""It rests no longer than this, whatever a slow disk or a busy machine made of its work."""
_AT_ONCE = 8
"""Rows that are fetched at a time."""
_T = TypeVar("_T")


class TooManyReadersError(Exception):
    """So many answers from the record are under way that there is no slot for another one."""


class Reader:
    """The access of a query to the record: its rows, and a pace. For one thread."""

    def __init__(self, database: Database, count_answers: Callable[[], int] = lambda: 1) -> None:
        """Read a database; `count_answers` tells how many answers are under way."""
        self._database, self._count_answers = database, count_answers
        self.begin()

    def rows(self, statement: Select[Any], **parameters: object) -> list[Row[*tuple[Any, ...]]]:
        """Return the rows of a statement with these parameters; raises RecordAwayError."""
        rows: list[Row[*tuple[Any, ...]]] = []
        with self._database.reading() as connection:
            for part in connection.execute(statement, parameters).partitions(_AT_ONCE):
                rows += part
                self.rest()
        return rows

    def begin(self) -> None:
        """Begin to work, in this thread."""
        self._begin_s = time.perf_counter()

    def rest(self) -> None:
        """Leave the interpreter to others for a while if it is time; call this after each row that was worked on."""
        # By the clock: on a busy machine, a reader is put aside while it has the interpreter, and others wait for it.
        worked_s = time.perf_counter() - self._begin_s
        if worked_s >= _WORK_S:
            times = min(_REST * self._count_answers(), _MOST_REST)
            select([], [], [], min(times * worked_s, _LONGEST_REST_S))
            self.begin()


class Readers:
    """All readers of the record of a service."""

    def __init__(self, database: Database) -> None:
        self._database, self._threads = database, Workers("reader", READERS)
        self._slots, self._answers = asyncio.Semaphore(MAX_ANSWERS), 0

    @asynccontextmanager
    async def slot(self) -> AsyncIterator[None]:
        """Have a slot for an answer during a block; raises TooManyReadersError."""
        is_there = False
        with suppress(TimeoutError):
            async with asyncio.timeout(SLOT_S):
                is_there = await self._slots.acquire()
        if not is_there:
            raise TooManyReadersError
        self._answers += 1
        try:
            yield
        finally:
            self._answers -= 1
            self._slots.release()

    async def read(self, query: Callable[[Reader], _T]) -> _T:
        """Return the answer to a query of what is durable; raises RecordAwayError."""
        return await self._run(lambda: query(self._make_reader()))

    async def read_parts(self, query: Callable[[Reader], Iterator[_T]]) -> AsyncIterator[_T]:
        """Give an answer in parts, each made once the one before it is taken; raises RecordAwayError.

        Meanwhile the threads make parts of others.
        """
        reader = self._make_reader()
        parts = query(reader)

        def make_next() -> _T | None:
            reader.begin()
            return next(parts, None)

        while (part := await self._run(make_next)) is not None:
            yield part

    def _make_reader(self) -> Reader:
        return Reader(self._database, lambda: self._answers)

    async def _run(self, call: Callable[[], _T]) -> _T:
        try:
            async with asyncio.timeout(QUERY_S):
                return await self._threads.run(call)
        except TimeoutError:
            raise RecordAwayError(f"it has not answered for {QUERY_S:g} s") from None

    def end(self) -> None:
        """End the threads after what they were told to read."""
        self._threads.end()
