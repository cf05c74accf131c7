"""Events in a database, joined from segments. One thread at a time; every call is one transaction."""

from collections.abc import Iterable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from sqlalchemy import ColumnElement, Connection, Row, UnaryExpression, delete, func, insert, select, tuple_, update

from beamtouch_service.events.file import EventFile
from beamtouch_service.events.schema import EVENTS, IS_OPEN
from beamtouch_service.events.segmenter import Command, Finish, Loss, TouchSeen
from beamtouch_service.events.segments import Begin, End, Segment, joined

_PRUNE_SHARE = 20
"""Prune 1/20 of the events at a time."""
_CONTENT = [EVENTS.c.id, *(EVENTS.c[entry.name] for entry in fields(Segment))]
_WITHOUT_PATH = [column for column in _CONTENT if column is not EVENTS.c.path]
_c = EVENTS.c

Numbered = tuple[int, Segment]
"""Id and content of an event."""


@dataclass(frozen=True)
class Selection:
    """Selects events to read, newest first."""

    surface: str | None = None
    since_us: int | None = None
    """Earliest touch."""
    until_us: int | None = None
    """The touch is before this time."""
    after: tuple[int, int] | None = None
    """Touch time and id of the last event that was read."""
    limit: int = 100
    path: bool = True
    """Read paths too; they are by far the largest part of an event."""


class EventStore:
    """The events of all surfaces."""

    def __init__(self, path: Path | None, keep_s: float, max_bytes: int, wait_s: float = 0.0) -> None:
        """Open the file, waiting up to `wait_s` [s] for another service to release it; raises EventStoreError."""
        self._keep_s, self._max_bytes = keep_s, max_bytes
        self._file = EventFile(path, wait_s)
        self._engine = self._file.engine

    def write(self, surface: str, commands: Iterable[Command], now_s: float) -> None:
        """Carry out all commands, or none, at `now_s` [s since 1970, by the service's clock]."""
        with self._engine.begin() as connection:
            for command in commands:
                if isinstance(command, Segment):
                    _add(connection, command, now_s)
                else:
                    _complete(connection, surface, command)

    def read(self, selection: Selection) -> list[Numbered]:
        """Return the selected events, newest touch first."""
        query = select(*(_CONTENT if selection.path else _WITHOUT_PATH))
        if selection.surface is not None:
            query = query.where(_c.surface == selection.surface)
        if selection.since_us is not None:
            query = query.where(_c.touched_us >= selection.since_us)
        if selection.until_us is not None:
            query = query.where(_c.touched_us < selection.until_us)
        if selection.after:
            query = query.where(tuple_(_c.touched_us, _c.id) < tuple_(*selection.after))
        query = query.order_by(_c.touched_us.desc(), _c.id.desc()).limit(selection.limit)
        with self._engine.connect() as connection:
            return [_numbered(row) for row in connection.execute(query)]

    def get(self, number: int) -> Segment | None:
        """Return the event of that id; None if there is none."""
        with self._engine.connect() as connection:
            found = _first(connection, _c.id == number)
        return found[1] if found else None

    def goes_on(self, surface: str, boot_id: str, sequence: int) -> bool:
        """Return whether a stored contact whose lift was not seen ends with that sample."""
        of_sample = (_c.surface == surface) & (_c.boot_id == boot_id) & (_c.last_sequence == sequence)
        with self._engine.connect() as connection:
            return connection.scalar(select(_c.id).where(of_sample, _c.end != End.LIFT).limit(1)) is not None

    def prune(self, now_s: float) -> int:
        """Delete events too old at `now_s` [s since 1970], then the oldest above the size limit; return how many."""
        with self._engine.begin() as connection:
            deleted = connection.execute(delete(EVENTS).where(_c.recorded_s < now_s - self._keep_s)).rowcount
        while self.used_bytes() > self._max_bytes:
            with self._engine.begin() as connection:
                count = connection.scalar(select(func.count()).select_from(EVENTS)) or 0
                oldest = select(_c.id).order_by(_c.recorded_s).limit(max(1, count // _PRUNE_SHARE))
                removed = connection.execute(delete(EVENTS).where(_c.id.in_(oldest))).rowcount
            if not removed:
                break
            deleted += removed
        return deleted

    def used_bytes(self) -> int:
        """Return the size of the stored events."""
        return self._file.used_bytes()

    def is_in_place(self) -> bool:
        """Return whether the file can still be found at its path."""
        return self._file.is_in_place()

    def close(self) -> None:
        """Mark open events as unfinished and close the file."""
        self._file.close()


def _complete(connection: Connection, surface: str, command: Finish | TouchSeen | Loss) -> None:
    change = update(EVENTS).where(_c.surface == surface)
    if isinstance(command, Finish):
        # A gap or silence ends only an open event; a lift also ends one that was interrupted just before it.
        endable = [end for end in End if end is not End.LIFT] if command.end is End.LIFT else [End.OPEN]
        of_sample = (_c.boot_id == command.boot_id) & (_c.last_sequence == command.last_sequence)
        change = change.where(of_sample, _c.end.in_(endable)).values(end=command.end, lifted_us=command.lifted_us)
    elif isinstance(command, TouchSeen):
        of_sample = (_c.boot_id == command.boot_id) & (_c.first_sequence == command.first_sequence)
        change = change.where(of_sample).values(begin=Begin.TOUCH)
    else:
        change = change.where(IS_OPEN).values(end=End.UNSEEN)
    connection.execute(change)


def _add(connection: Connection, segment: Segment, now_s: float) -> None:
    same = (_c.surface == segment.surface) & (_c.boot_id == segment.boot_id) & (_c.model == segment.model)
    first, last = segment.first_sequence, segment.last_sequence
    # Segments may overlap: after a restart of the service, the sender may send samples again.
    reaches = _c.last_sequence >= first
    if segment.begin is Begin.UNSEEN:
        reaches |= (_c.last_sequence == first - 1) & (_c.end != End.LIFT)
    # The plain bound on the last sample is for the index.
    left = _first(
        connection,
        same,
        _c.first_sequence <= first,
        _c.last_sequence >= first - 1,
        reaches,
        order=_c.last_sequence.desc(),
    )
    if left and left[1].last_sequence >= last:
        return
    number, whole = (left[0], joined(left[1], segment)) if left else (None, segment)
    follows = _c.first_sequence.between(first + 1, last + 1) & (_c.begin == Begin.UNSEEN)
    right = _first(connection, same, follows, order=_c.first_sequence.asc())
    if right:
        whole = joined(whole, right[1])
        if number is None:
            number = right[0]
        else:
            connection.execute(delete(EVENTS).where(_c.id == right[0]))
    _put(connection, number, whole, now_s)


def _put(connection: Connection, number: int | None, segment: Segment, now_s: float) -> None:
    values = vars(segment) | {"recorded_s": now_s}
    if number is None:
        number = connection.scalar(insert(EVENTS).values(values).returning(_c.id))
    else:
        connection.execute(update(EVENTS).where(_c.id == number).values(values))
    if segment.end is End.OPEN:
        # A surface has one newest sample. Another open event was left by a lost write.
        others = (_c.surface == segment.surface) & IS_OPEN & (_c.id != number)
        connection.execute(update(EVENTS).where(others).values(end=End.UNSEEN))


def _first(
    connection: Connection, *conditions: ColumnElement[bool], order: UnaryExpression[int] | None = None
) -> Numbered | None:
    row = connection.execute(select(*_CONTENT).where(*conditions).order_by(order).limit(1)).first()
    return _numbered(row) if row else None


def _numbered(row: Row[Any]) -> Numbered:
    values = row._asdict()
    number = values.pop("id")
    values["path"] = [(at, position, force) for at, position, force in values.get("path", ())]
    return number, Segment(**values)
