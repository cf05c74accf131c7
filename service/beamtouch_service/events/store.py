"""Events in a database, joined from segments. One thread at a time; every call is one transaction."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from sqlalchemy import BigInteger, Connection, Row, Select, bindparam, delete, func, insert, select, tuple_, update

from beamtouch_service.events.file import EventFile
from beamtouch_service.events.schema import EVENTS, IS_OPEN
from beamtouch_service.events.segmenter import Command, Finish, Loss, TouchSeen
from beamtouch_service.events.segments import Begin, End, Segment, joined

_PRUNE_SHARE = 20
"""Prune 1/20 of the events at a time."""
_CONTENT = [EVENTS.c.id, *(EVENTS.c[entry.name] for entry in fields(Segment))]
_WITHOUT_PATH = [column for column in _CONTENT if column is not EVENTS.c.path]
_c = EVENTS.c
# Made once: making a statement takes longer than carrying it out.
_of_id = _c.id == bindparam("of_id")
_of_surface = _c.surface == bindparam("of_surface")
_of_sender = _of_surface & (_c.boot_id == bindparam("of_boot_id"))
_of_model = _of_sender & (_c.model == bindparam("of_model"))
_ends_at = _of_sender & (_c.last_sequence == bindparam("of_sequence"))
_begins_at = _of_sender & (_c.first_sequence == bindparam("of_sequence"))
_first, _last = bindparam("first", type_=BigInteger), bindparam("last", type_=BigInteger)
_BY_ID = select(*_CONTENT).where(_of_id)
_LEFT = (
    select(*_CONTENT)
    .where(_of_model, _c.first_sequence <= _first, _c.last_sequence >= _first - 1)
    .order_by(_c.last_sequence.desc())
    .limit(1)
)
"""The event that holds the first sample of a segment, or ends just before it."""
_RIGHT = (
    select(*_CONTENT)
    .where(_of_model, _c.first_sequence.between(_first + 1, _last + 1), _c.begin == Begin.UNSEEN)
    .order_by(_c.first_sequence)
    .limit(1)
)
"""The event that begins in a segment, or just after it."""
_GOES_ON = select(_c.id).where(_ends_at, _c.end != End.LIFT).limit(1)
_INSERT = insert(EVENTS).returning(_c.id)
_UPDATE = update(EVENTS).where(_of_id)
_DELETE = delete(EVENTS).where(_of_id)
_TOUCH = update(EVENTS).where(_begins_at).values(begin=Begin.TOUCH)
# A gap or silence ends only an open event; a lift also ends one that was interrupted just before it.
_LIFT = update(EVENTS).where(_ends_at, _c.end != End.LIFT)
_INTERRUPT = update(EVENTS).where(_ends_at, IS_OPEN)
_END_OPEN = update(EVENTS).where(_of_surface, IS_OPEN, _c.id != bindparam("of_id")).values(end=End.UNSEEN)
_NO_ID = 0

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
            found = _found(connection, _BY_ID, {"of_id": number})
        return found[1] if found else None

    def goes_on(self, surface: str, boot_id: str, sequence: int) -> bool:
        """Return whether a stored contact whose lift was not seen ends with that sample."""
        sample = {"of_surface": surface, "of_boot_id": boot_id, "of_sequence": sequence}
        with self._engine.connect() as connection:
            return connection.execute(_GOES_ON, sample).first() is not None

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
    values: dict[str, object] = {"of_surface": surface}
    if isinstance(command, Finish):
        statement = _LIFT if command.end is End.LIFT else _INTERRUPT
        values |= {"of_boot_id": command.boot_id, "of_sequence": command.last_sequence}
        values |= {"end": command.end, "lifted_us": command.lifted_us}
    elif isinstance(command, TouchSeen):
        statement = _TOUCH
        values |= {"of_boot_id": command.boot_id, "of_sequence": command.first_sequence}
    else:
        statement = _END_OPEN
        values["of_id"] = _NO_ID
    connection.execute(statement, values)


def _add(connection: Connection, segment: Segment, now_s: float) -> None:
    first, last = segment.first_sequence, segment.last_sequence
    near: dict[str, object] = {"of_surface": segment.surface, "of_boot_id": segment.boot_id, "of_model": segment.model}
    near |= {"first": first, "last": last}
    # Segments may overlap: after a restart of the service, the sender may send samples again.
    left = _found(connection, _LEFT, near)
    if left and left[1].last_sequence >= last:
        return
    if left and left[1].last_sequence < first and (segment.begin is Begin.TOUCH or left[1].end is End.LIFT):
        left = None
    number, whole = (left[0], joined(left[1], segment)) if left else (None, segment)
    right = _found(connection, _RIGHT, near)
    if right:
        whole = joined(whole, right[1])
        if number is None:
            number = right[0]
        else:
            connection.execute(_DELETE, {"of_id": right[0]})
    _put(connection, number, whole, now_s)


def _put(connection: Connection, number: int | None, segment: Segment, now_s: float) -> None:
    values = vars(segment) | {"recorded_s": now_s}
    if number is None:
        number = connection.execute(_INSERT, values).scalar_one()
    else:
        connection.execute(_UPDATE, values | {"of_id": number})
    if segment.end is End.OPEN:
        # A surface has one newest sample. Another open event was left by a lost write.
        connection.execute(_END_OPEN, {"of_surface": segment.surface, "of_id": number})


def _found(connection: Connection, query: Select[Any], values: Mapping[str, object]) -> Numbered | None:
    row = connection.execute(query, values).first()
    return _numbered(row) if row else None


def _numbered(row: Row[Any]) -> Numbered:
    values = row._asdict()
    number = values.pop("id")
    values["path"] = [(at, position, force) for at, position, force in values.get("path", ())]
    return number, Segment(**values)
