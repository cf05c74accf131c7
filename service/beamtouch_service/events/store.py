"""Events in a database, joined from segments. One thread at a time; every call is one transaction."""

from collections.abc import Collection, Iterable
from pathlib import Path

from sqlalchemy import ColumnElement, Connection, delete, func, select

from beamtouch_models.modelfile import State
from beamtouch_service.events import best_table, capture_table, deliveries, edge_table, writing
from beamtouch_service.events.best_table import Baseline, Sampled
from beamtouch_service.events.captures import Capture
from beamtouch_service.events.database import EventDatabase
from beamtouch_service.events.deliveries import Due
from beamtouch_service.events.file import EventFile
from beamtouch_service.events.findings import Command, Edge
from beamtouch_service.events.schema import EVENTS
from beamtouch_service.events.segments import Segment
from beamtouch_service.events.selection import Selection
from beamtouch_service.events.writing import Numbered
from beamtouch_service.surfaces.contradiction import Contradiction

_PRUNE_SHARE = 20
"""Prune 1/20 of the captures, or of the events, at a time."""
_c = EVENTS.c


class EventStore:
    """The events of all surfaces: in a file or in memory, or in a database of several services.

    While the file or the database is away, every call raises EventsAwayError.
    """

    def __init__(self, place: Path | str | None, keep_s: float, max_bytes: int) -> None:
        """Open a file, the database of a URL, or memory; raises EventStoreError."""
        self._keep_s, self._max_bytes = keep_s, max_bytes
        self._place = EventDatabase(place) if isinstance(place, str) else EventFile(place)

    @property
    def is_shared(self) -> bool:
        """Whether other services may record events of the same surfaces."""
        return self._place.is_shared

    def write(self, surface: str, commands: Iterable[Command], now_s: float) -> None:
        """Carry out all commands, or none, at `now_s` [s since 1970, by the service's clock]."""
        with self._place.begin(surface) as connection:
            for command in commands:
                if isinstance(command, Segment):
                    writing.add(connection, command, now_s)
                elif isinstance(command, Capture):
                    capture_table.write(connection, surface, command)
                elif isinstance(command, Edge):
                    writing.note(connection, surface, command, now_s)
                else:
                    writing.complete(connection, surface, command)

    def read(self, selection: Selection) -> list[Numbered]:
        """Return the selected events, newest touch first."""
        with self._place.connect() as connection:
            return [writing.numbered(row) for row in connection.execute(selection.query())]

    def get(self, number: int) -> Segment | None:
        """Return the event of that id; None if there is none."""
        with self._place.connect() as connection:
            found = writing.found(connection, writing.BY_ID, {"of_id": number})
        return found[1] if found else None

    def capture(self, event: Segment) -> list[Contradiction]:
        """Return the samples that are kept of the unexplained stretches of an event, in order."""
        with self._place.connect() as connection:
            return capture_table.read(connection, event)

    def captured(self, numbers: Collection[int]) -> set[int]:
        """Return which of these events have samples of unexplained stretches."""
        with self._place.connect() as connection:
            return capture_table.captured(connection, numbers)

    def best_samples(self, surface: str, since_us: int | None, until_us: int | None, limit: int) -> list[Sampled]:
        """Return the newest contacts of a surface that have a best sample, oldest first, by the time of their touch."""
        with self._place.connect() as connection:
            return best_table.contacts(connection, surface, since_us, until_us, limit)

    def ended_after(self, surface: str, number: int, max_events: int) -> list[Sampled]:
        """Return events of higher ids with a best sample, in the order of their ids, up to the first that is open."""
        with self._place.connect() as connection:
            return best_table.ended_after(connection, surface, number, max_events)

    def baseline(self, surface: str) -> Baseline | None:
        """Return what is kept of the health of a surface; None if nothing is."""
        with self._place.connect() as connection:
            return best_table.baseline(connection, surface)

    def keep_baseline(self, kept: Baseline) -> None:
        """Keep this of the health of a surface."""
        with self._place.begin() as connection:
            best_table.keep(connection, kept)

    def begin_delivery(self, destination: str, *, from_start: bool) -> None:
        """Make a destination of events known: from now on, or from the start of the record."""
        with self._place.begin() as connection:
            deliveries.begin(connection, destination, from_start=from_start)

    def due(self, destination: str, limit: int) -> tuple[list[Due], int]:
        """Return finished events that a destination has yet to acknowledge, in order, and how many there are."""
        with self._place.connect() as connection:
            count = deliveries.count(connection, destination)
            return deliveries.due(connection, destination, limit) if limit and count else [], count

    def acknowledge(self, destination: str, last: Due) -> None:
        """Note that a destination has acknowledged all changes up to this one."""
        with self._place.begin() as connection:
            deliveries.acknowledge(connection, destination, last)

    def state_after(self, surface: str, boot_id: str, sequence: int) -> State | None:
        """Return the state after that sample, if a stored event ends with it and may go on; None if none does."""
        sample = {"of_surface": surface, "of_boot_id": boot_id, "of_sequence": sequence}
        with self._place.connect() as connection:
            ends_unexplained = connection.execute(writing.GOES_ON, sample).scalar()
        if ends_unexplained is None:
            return None
        return State.UNEXPLAINED if ends_unexplained else State.CONTACT

    def edge(self, surface: str, boot_id: str, sequence: int) -> Edge | None:
        """Return that sample, if it is next to a gap and kept; None if not."""
        with self._place.connect() as connection:
            return edge_table.find(connection, surface, boot_id, sequence)

    def finish_abandoned(self, before_s: float) -> None:
        """End the open events whose service has written nothing of them since `before_s` [s since 1970]."""
        with self._place.begin() as connection:
            writing.finish_abandoned(connection, before_s)

    def prune(self, now_s: float) -> int:
        """Delete events too old at `now_s` [s since 1970]; return how many.

        Above the size limit, the oldest captures go first, so that a faulty sensor does not push out the contacts. Only
        then go the oldest events.
        """
        with self._place.begin() as connection:
            edge_table.drop_old(connection, now_s)
            deleted = _delete(connection, _c.recorded_s < now_s - self._keep_s)
        while self.used_bytes() > self._max_bytes:
            with self._place.begin() as connection:
                if not capture_table.drop_oldest(connection, _PRUNE_SHARE):
                    break
        while self.used_bytes() > self._max_bytes:
            with self._place.begin() as connection:
                count = connection.scalar(select(func.count()).select_from(EVENTS)) or 0
                oldest = select(_c.id).order_by(_c.recorded_s).limit(max(1, count // _PRUNE_SHARE))
                removed = _delete(connection, _c.id.in_(oldest))
            if not removed:
                break
            deleted += removed
        return deleted

    def used_bytes(self) -> int:
        """Return the size of the stored events."""
        return self._place.used_bytes()

    def is_in_place(self) -> bool:
        """Return whether the file can still be found at its path."""
        return self._place.is_in_place()

    def close(self) -> None:
        """Close the file or the connection. The open events of a file are then unfinished."""
        self._place.close()

    def abandon(self) -> None:
        """End a call of another thread that waits for a database."""
        self._place.abandon()

    def abandon_stuck(self) -> None:
        """End such a call if it has waited for so long that the database must be frozen."""
        self._place.abandon_stuck()


def _delete(connection: Connection, these: ColumnElement[bool]) -> int:
    """Delete events with their captures; return how many events."""
    capture_table.drop(connection, these)
    return connection.execute(delete(EVENTS).where(these)).rowcount
