"""Writes of the recorder's thread: carried out in order, and kept while the database or the file is away."""

import logging
import time
from collections.abc import Callable, Sequence
from typing import TypeVar

from sqlalchemy.exc import DBAPIError

from beamtouch_service.events.backlog import Backlog
from beamtouch_service.events.file import EventsAwayError
from beamtouch_service.events.findings import Command, Loss
from beamtouch_service.events.losses import Losses
from beamtouch_service.events.store import EventStore

RETRY_S = 1.0
"""Time between two attempts to reach a database that is away; in between, queries fail at once."""

_log = logging.getLogger("beamtouch.service.events")

_T = TypeVar("_T")
MakeCommands = Callable[[], Sequence[Command]]


class Writer:
    """Writes to the store. Only the worker thread calls it; the counts may be read by others.

    Parameters
    ----------
    store
        The store.
    losses
        Counts what is lost.
    written
        Called after each write with the name of its surface.
    """

    def __init__(self, store: EventStore, losses: Losses, written: Callable[[str], None]) -> None:
        self.incomplete: set[str] = set()
        """Surfaces that lost a write: their open event may have ended."""
        self.outages = 0
        """Times that the database went away."""
        self._store = store
        self._losses = losses
        self._written = written
        self._backlog = Backlog()
        self._away_since_s: float | None = None
        self._reason = ""
        self._retry_s = 0.0

    @property
    def is_away(self) -> bool:
        """Whether the database takes nothing."""
        return self._away_since_s is not None

    @property
    def away_because(self) -> str:
        """Why the database takes nothing; empty if it takes writes."""
        return self._reason if self.is_away else ""

    @property
    def waiting(self) -> int:
        """Writes that wait for the database."""
        return len(self._backlog)

    def write_new(self, name: str, make: MakeCommands) -> None:
        """Write the commands that `make` returns, of new samples; if they are lost, the surface is incomplete."""
        if not self._losses.attempt(lambda: self._write_new(name, make)):
            self.incomplete.add(name)

    def write_late(self, name: str, make: MakeCommands) -> None:
        """Write the commands that `make` returns, of late samples."""
        self._losses.attempt(lambda: self._write(name, make()))

    def catch_up(self) -> None:
        """End events that a lost write left open, and carry out what waits; raises DBAPIError."""
        for name in list(self.incomplete):
            self._write_new(name, list)
        self.drain()

    def ask(self, query: Callable[[EventStore], _T]) -> _T:
        """Return the answer to a query, after all writes so far; raises EventsAwayError."""
        if not self.drain() or self._is_resting():
            raise EventsAwayError(self._reason)
        try:
            answer = query(self._store)
        except EventsAwayError:
            # The connection ended when the database was restarted. Another one may do.
            try:
                answer = query(self._store)
            except EventsAwayError as error:
                self._away(str(error))
                raise
        self._back()
        return answer

    def drain(self) -> bool:
        """Carry out the writes that wait, oldest first; return whether none is left."""
        while not self._is_resting() and (write := self._backlog.take_first()):
            try:
                self._store.write(write.surface, write.commands, time.time())
            except EventsAwayError as error:
                self._backlog.put_back(write)
                self._away(str(error))
            except DBAPIError as error:
                self._losses.note(str(error.orig))
                self.incomplete.add(write.surface)
            else:
                self._back()
                self._written(write.surface)
        return not self._backlog

    def give_up(self) -> None:
        """Count what still waits as lost."""
        self._losses.count += len(self._backlog)

    def _write_new(self, name: str, make: MakeCommands) -> None:
        is_incomplete = name in self.incomplete
        # Discarded before the write: a write that is lost meanwhile adds it again.
        self.incomplete.discard(name)
        try:
            self._write(name, [*([Loss()] if is_incomplete else []), *make()])
        except DBAPIError:
            self.incomplete.add(name)
            raise

    def _write(self, name: str, commands: Sequence[Command]) -> None:
        if not commands:
            return
        if not (self._store.is_shared or self.is_away):
            try:
                self._store.write(name, commands, time.time())
            except EventsAwayError as error:
                self._away(str(error))
            else:
                self._written(name)
                return
        if self._backlog.add(name, commands):
            self.drain()
        else:
            self.incomplete.add(name)
            self._losses.note("the database of events has been away for too long")

    def _is_resting(self) -> bool:
        return self.is_away and time.monotonic() < self._retry_s

    def _away(self, reason: str) -> None:
        self._reason, self._retry_s = reason, time.monotonic() + RETRY_S
        if self._away_since_s is None:
            self._away_since_s = time.monotonic()
            self.outages += 1
            _log.warning("the database of events is away; events are kept in memory until it is back: %s", reason)

    def _back(self) -> None:
        if self._away_since_s is not None:
            away_s, self._away_since_s = time.monotonic() - self._away_since_s, None
            _log.info("the database of events is back after %.1f s; what was kept is written", away_s)
