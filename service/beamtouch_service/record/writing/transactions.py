"""The record: cursors, events, what destinations have yet to get, and health. Every call is one transaction."""

import logging
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sqlalchemy import (
    ColumnElement,
    Connection,
    Row,
    Table,
    bindparam,
    delete,
    func,
    insert,
    join,
    null,
    select,
    true,
    tuple_,
    update,
)

from beamtouch_service.record.database.connections import Database
from beamtouch_service.record.database.errors import UnreadableRowError
from beamtouch_service.record.database.postgresql import ServerDatabase
from beamtouch_service.record.database.sqlite import FileDatabase, MemoryDatabase
from beamtouch_service.record.database.tables import (
    BLOCK_ROWS,
    CONTENT,
    CURSOR_ROWS,
    CURSORS,
    DELIVERIES,
    DESTINATIONS,
    EVENTS,
    HEALTH,
    HEALTH_BLOCKS,
    HEALTH_ROWS,
    IS_FINISHED,
    WITHOUT_PATH,
    event_of,
    read_time,
)
from beamtouch_service.record.events.changes import BootChange, Change, Cursor
from beamtouch_service.record.events.event import End, Event, OpenEvent
from beamtouch_service.record.events.health import BlockKey, StoredHealth
from beamtouch_service.record.trail.entry import Entry
from beamtouch_service.record.trail.table import Added, add_entries
from beamtouch_service.sections import EventsSection

_log = logging.getLogger(__name__)
_c = EVENTS.c
_FIXED = {column.name for index in EVENTS.indexes for column in index.columns} - {"recorded_s"}
"""Columns that stay as they were when the event began. To write them again would write their indexes, too."""


@dataclass(frozen=True)
class Due:
    """A finished event that a destination has yet to acknowledge."""

    delivery: int
    number: int
    event: Event


def open_database(where: Path | str | None) -> Database:
    """Open a file, the database of a URL, or memory; raises RecordUnusableError."""
    if where is None:
        return MemoryDatabase()
    return ServerDatabase(where) if isinstance(where, str) else FileDatabase(where)


class Transactions:
    """The record of all surfaces. While its database is away, every call raises RecordAwayError."""

    def __init__(self, events: EventsSection) -> None:
        """Open a file, the database of a URL, or memory; raises RecordUnusableError."""
        self.is_lasting = bool(events.url or events.file)
        """True if the record outlives the service."""
        self.database = open_database(events.url or events.file)

    @property
    def away_because(self) -> str:
        """Return why the database was away at the start; empty if it was not."""
        return self.database.away_because

    def load(self, surface: str, boot_id: str) -> tuple[list[Cursor], StoredHealth]:
        """Return the cursors of this boot and of those with an open event, and the health of the surface.

        Raises UnreadableRowError if one of them or of these events is damaged.
        """
        of_boot = (CURSORS.c.boot_id == boot_id) | CURSORS.c.event.is_not(null())
        query = select(CURSORS).where(CURSORS.c.surface == surface, of_boot)
        with self.database.reading_as_writer() as connection:
            rows = connection.execute(query).all()
            for row in rows:
                CURSOR_ROWS.require_whole(f"the cursor of boot {row.boot_id} of surface {surface}", row._asdict())
            numbers = [row.event for row in rows if row.event is not None]
            content = connection.execute(select(_c.id, *CONTENT).where(_c.id.in_(numbers)))
            events = {one.number: one for one in map(event_of, content) if one.event.end is End.OPEN}
            healths = _read_healths(connection, HEALTH.c.surface == surface)
        cursors = [
            Cursor(row.boot_id, row.durable, row.version, row.model, row.memory, events.get(row.event)) for row in rows
        ]
        return cursors, healths.get(surface, StoredHealth())

    def healths(self) -> dict[str, StoredHealth]:
        """Return the health of each surface that has one on record."""
        with self.database.reading_as_writer() as connection:
            return _read_healths(connection, true())

    def commit(self, changes: Sequence[Change]) -> tuple[dict[OpenEvent, int], set[str]]:
        """Make changes durable.

        A surface of which a row no longer stands where its change says is left as it is. Returns the ids of new
        events, and the names of these surfaces.
        """
        with self.database.writing() as connection:
            lost = _find_lost(connection, changes)
            held = [change for change in changes if change.surface not in lost]
            boots = [(change.surface, boot) for change in held for boot in change.boots]
            time_s, _ = read_time(connection)
            numbers = _write_events(connection, [event for _, boot in boots for event in boot.events], time_s)
            _write(connection, CURSORS, [_cursor_row(name, boot, numbers, time_s) for name, boot in boots])
            _write_healths(connection, held)
        return numbers, lost

    def due(self, destination: str, limit: int, *, from_start: bool) -> tuple[list[Due], int]:
        """Return the first finished events that a destination has yet to acknowledge, in order, and how many there are.

        A destination that the record does not know gets the events that finish from now on, or all. A damaged one is
        due no longer, and the log names it: it would hold up all that follow it. If all of the first `limit` are
        damaged, there are none, and the next call has those that follow.
        """
        is_due = DELIVERIES.c.destination == destination
        query = (
            select(DELIVERIES.c.number, _c.id, *WITHOUT_PATH)
            .join(EVENTS, _c.id == DELIVERIES.c.event)
            .where(is_due)
            .order_by(DELIVERIES.c.number)
            .limit(limit)
        )
        with self.database.writing() as connection:
            _make_known(connection, destination, from_start=from_start)
            due, damages = _read_due(connection.execute(query).all())
            _end_deliveries(connection, damages)
            count = connection.scalar(select(func.count()).select_from(DELIVERIES).where(is_due)) or 0
        for damage in damages.values():
            _log.error("%s never gets an event: %s", destination, damage)
        return due, count

    def acknowledge(self, delivered: Collection[Due]) -> None:
        """Note that these events were acknowledged."""
        with self.database.writing() as connection:
            _end_deliveries(connection, [one.delivery for one in delivered])

    def add_to_trail(self, entries: Sequence[Entry]) -> list[Added]:
        """Add the entries that say something new to the trail; return them."""
        with self.database.writing() as connection:
            return add_entries(connection, entries)

    def close(self) -> None:
        """Close the connections."""
        self.database.close()


def _read_due(rows: Sequence[Row[*tuple[Any, ...]]]) -> tuple[list[Due], dict[int, str]]:
    """Return the whole events of rows, and for the delivery of each other one its damage."""
    due, damages = list[Due](), dict[int, str]()
    for row in rows:
        try:
            due.append(Due(row.number, *event_of(row)))
        except UnreadableRowError as error:
            damages[row.number] = str(error)
    return due, damages


def _end_deliveries(connection: Connection, numbers: Collection[int]) -> None:
    if numbers:
        connection.execute(delete(DELIVERIES).where(DELIVERIES.c.number.in_(numbers)))


def _find_lost(connection: Connection, changes: Sequence[Change]) -> set[str]:
    """Return the surfaces of which another service has written a row since this one read it."""
    boots = {(change.surface, boot.boot_id): boot.version for change in changes for boot in change.boots}
    is_of_boot = tuple_(CURSORS.c.surface, CURSORS.c.boot_id).in_(list(boots))
    cursors = connection.execute(select(CURSORS.c.surface, CURSORS.c.boot_id, CURSORS.c.version).where(is_of_boot))
    versions = {(surface, boot_id): version for surface, boot_id, version in cursors}
    lost = {surface for (surface, boot_id), before in boots.items() if versions.get((surface, boot_id), 0) != before}
    dirty = {change.surface: change.health.stored.version for change in changes if change.health.next}
    healths = connection.execute(select(HEALTH.c.surface, HEALTH.c.version).where(HEALTH.c.surface.in_(list(dirty))))
    stands = {row.surface: _health_version(row) for row in healths}
    return lost | {surface for surface, before in dirty.items() if stands.get(surface, 0) != before}


def _write(connection: Connection, table: Table, rows: list[dict[str, Any]]) -> None:
    """Insert the rows that are written for the first time, and update the others."""
    if new := [row for row in rows if row["version"] == 1]:
        connection.execute(insert(table), new)
    if again := [row for row in rows if row["version"] > 1]:
        keys = [column.name for column in table.primary_key]
        is_row = [table.c[name] == bindparam(f"of_{name}") for name in keys]
        # A key that is written again is written in its index, too, though it is the same.
        values = [{f"of_{name}" if name in keys else name: value for name, value in row.items()} for row in again]
        connection.execute(update(table).where(*is_row), values)


def _write_events(
    connection: Connection, events: Sequence[tuple[OpenEvent, int | None, dict[str, Any]]], time_s: float
) -> dict[OpenEvent, int]:
    """Write events, and what destinations get of them; return the ids of new ones."""
    numbers: dict[OpenEvent, int] = {}
    again = list[dict[str, Any]]()
    for event, number, row in events:
        values = row | {"recorded_s": time_s}
        if number is None:
            numbers[event] = connection.execute(insert(EVENTS).returning(_c.id), values).scalar_one()
        else:
            again.append({name: value for name, value in values.items() if name not in _FIXED} | {"of_id": number})
    if again:
        connection.execute(update(EVENTS).where(_c.id == bindparam("of_id")), again)
    finished = [numbers.get(event, number) for event, number, row in events if row["end"] is not End.OPEN]
    if finished:
        both = join(EVENTS, DESTINATIONS, true())
        each = select(DESTINATIONS.c.name, _c.id).select_from(both).where(_c.id.in_(finished)).order_by(_c.id)
        connection.execute(insert(DELIVERIES).from_select(["destination", "event"], each))
    return numbers


def _read_healths(connection: Connection, which: ColumnElement[bool]) -> dict[str, StoredHealth]:
    """Return the health of surfaces. That of one with a damaged row says so; those of others are whole."""
    rows = connection.execute(select(HEALTH).where(which)).all()
    is_of = HEALTH_BLOCKS.c.surface.in_([row.surface for row in rows])
    blocks: dict[str, dict[BlockKey, list[Any]]] = {row.surface: {} for row in rows}
    damage = {
        row.surface: HEALTH_ROWS.find_damage(f"the health of surface {row.surface}", row._asdict()) for row in rows
    }
    for row in connection.execute(select(HEALTH_BLOCKS).where(is_of)):
        blocks[row.surface][row.first_us, row.number] = row.block
        what = f"block {row.number} of {row.first_us} of the health of surface {row.surface}"
        damage[row.surface] = damage[row.surface] or BLOCK_ROWS.find_damage(what, row._asdict())
    return {
        row.surface: StoredHealth(
            _health_version(row), row.model, row.characteristic, row.newest_us, blocks[row.surface], damage[row.surface]
        )
        for row in rows
    }


def _health_version(row: Row[*tuple[Any, ...]]) -> int:
    """Return how often the health of a surface was written; 0 if that cannot be read."""
    return row.version if isinstance(row.version, int) and row.version > 0 else 0


def _write_healths(connection: Connection, changes: Sequence[Change]) -> None:
    """Write what changed of the health of surfaces."""
    rows, gone, new = list[dict[str, Any]](), list[dict[str, Any]](), list[dict[str, Any]]()
    for change in changes:
        before, after = change.health.stored.blocks, change.health.next
        if not after:
            continue
        row = {name: getattr(after, name) for name in ("version", "model", "characteristic", "newest_us")}
        rows.append({"surface": change.surface} | row)
        for key in before.keys() | after.blocks.keys():
            if before.get(key) == after.blocks.get(key):
                continue
            values = {"surface": change.surface, "first_us": key[0], "number": key[1]}
            if key in before:
                gone.append({f"of_{name}": value for name, value in values.items()})
            if key in after.blocks:
                new.append(values | {"block": after.blocks[key]})
    # One whose version cannot be read is written as for the first time.
    first = [row["surface"] for row in rows if row["version"] == 1]
    connection.execute(delete(HEALTH).where(HEALTH.c.surface.in_(first)))
    _write(connection, HEALTH, rows)
    if gone:
        is_gone = [column == bindparam(f"of_{column.name}") for column in HEALTH_BLOCKS.primary_key]
        connection.execute(delete(HEALTH_BLOCKS).where(*is_gone), gone)
    if new:
        connection.execute(insert(HEALTH_BLOCKS), new)


def _make_known(connection: Connection, destination: str, *, from_start: bool) -> None:
    if connection.execute(select(DESTINATIONS).where(DESTINATIONS.c.name == destination)).first():
        return
    connection.execute(insert(DESTINATIONS).values(name=destination))
    if from_start:
        each = select(bindparam("destination", destination), _c.id).where(IS_FINISHED).order_by(_c.id)
        connection.execute(insert(DELIVERIES).from_select(["destination", "event"], each))


def _cursor_row(surface: str, boot: BootChange, numbers: Mapping[OpenEvent, int], time_s: float) -> dict[str, Any]:
    event = boot.open_event
    return {
        "surface": surface,
        "boot_id": boot.boot_id,
        "durable": boot.durable,
        "version": boot.version + 1,
        "model": boot.model,
        "memory": boot.memory,
        "event": None if event is None else numbers.get(event, event.number),
        "recorded_s": time_s,
    }
