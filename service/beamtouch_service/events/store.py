"""The record: cursors, events, what destinations have yet to get, and health. Every call is one transaction."""

import time
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from sqlalchemy import (
    Connection,
    Row,
    Select,
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

from beamtouch_service.events.best import Best
from beamtouch_service.events.database import open_database
from beamtouch_service.events.event import AHEAD_S, End, Event, EventKind, OpenEvent
from beamtouch_service.events.health import HealthHistory
from beamtouch_service.events.tables import (
    CONTENT,
    CURSORS,
    DELIVERIES,
    DESTINATIONS,
    EVENTS,
    HEALTH,
    IS_FINISHED,
    TIME,
)
from beamtouch_service.sections import EventsSection

_c = EVENTS.c
_WITHOUT_PATH = [column for column in CONTENT if column not in (_c.path, _c.best, _c.capture)]

Numbered = tuple[int, Event]
"""Id and content of an event."""


@dataclass(frozen=True)
class Cursor:
    """How far the record of one boot is."""

    boot_id: str
    durable: int
    """Number of the last sample on record."""
    version: int
    """How often this was written."""
    model: str
    memory: dict[str, Any]
    event: Numbered | None
    """The open event."""


@dataclass(frozen=True)
class BootChange:
    """What the samples of one boot since its last change add to the record."""

    boot_id: str
    version: int
    """The version that it follows; 0 for a new boot."""
    durable: int
    model: str
    memory: dict[str, Any]
    events: list[tuple[OpenEvent, int | None, dict[str, Any]]]
    """Events that began, went on or ended: each with its id, if it is on record, and its row."""
    open_event: OpenEvent | None


@dataclass(frozen=True)
class Change:
    """What is to become durable of one surface."""

    surface: str
    boots: list[BootChange]
    best: list[Best]
    """Best samples of events that ended."""
    health: HealthHistory

    @property
    def has_ended(self) -> bool:
        """Whether events ended."""
        return any(row["end"] is not End.OPEN for boot in self.boots for _, _, row in boot.events)


@dataclass(frozen=True)
class Sampled:
    """An event with its best sample."""

    number: int
    model: str
    best: Best | None


@dataclass(frozen=True)
class Due:
    """A finished event that a destination has yet to acknowledge."""

    delivery: int
    number: int
    event: Event


class Store:
    """The record of all surfaces. While its database is away, every call raises EventsAwayError."""

    def __init__(self, events: EventsSection) -> None:
        """Open a file, the database of a URL, or memory; raises EventStoreError."""
        self.is_lasting = bool(events.url or events.file)
        """Whether the record outlives the service."""
        self.database = open_database(events.url or events.file)

    @property
    def away_because(self) -> str:
        """Why the database was away at the start; empty if it was not."""
        return self.database.away_because

    def load(self, surface: str, boot_id: str) -> tuple[list[Cursor], dict[str, Any] | None]:
        """Return the cursors of this boot and of those with an open event, and the row of the surface's health."""
        of_boot = (CURSORS.c.boot_id == boot_id) | CURSORS.c.event.is_not(null())
        query = select(CURSORS).where(CURSORS.c.surface == surface, of_boot)
        with self.database.loading() as connection:
            rows = connection.execute(query).all()
            numbers = [row.event for row in rows if row.event is not None]
            content = connection.execute(select(_c.id, *CONTENT).where(_c.id.in_(numbers)))
            events = {number: (number, event) for number, event in map(_event_of, content) if event.end is End.OPEN}
            health = connection.execute(select(HEALTH).where(HEALTH.c.surface == surface)).mappings().first()
        cursors = [
            Cursor(row.boot_id, row.durable, row.version, row.model, row.memory, events.get(row.event)) for row in rows
        ]
        return cursors, dict(health) if health else None

    def healths(self) -> dict[str, dict[str, Any]]:
        """Return the row of the health of each surface."""
        with self.database.loading() as connection:
            return {row["surface"]: dict(row) for row in connection.execute(select(HEALTH)).mappings()}

    def commit(self, changes: Sequence[Change]) -> tuple[dict[OpenEvent, int], set[str]]:
        """Make changes durable.

        A surface of which a row no longer stands where its change says is left as it is. Returns the ids of new
        events, and the names of these surfaces.
        """
        with self.database.writing() as connection:
            lost = _find_lost(connection, changes)
            held = [change for change in changes if change.surface not in lost]
            boots = [(change.surface, boot) for change in held for boot in change.boots]
            time_s = connection.scalars(select(TIME.c.passed_s)).one()
            numbers = _write_events(connection, [event for _, boot in boots for event in boot.events], time_s)
            _write(connection, CURSORS, [_cursor_row(name, boot, numbers, time_s) for name, boot in boots])
            healths = [change.health for change in held]
            _write(connection, HEALTH, [health.row() for health in healths if health.is_dirty])
        return numbers, lost

    def read(
        self,
        *,
        surface: str | None = None,
        kind: EventKind | None = None,
        since_us: int | None = None,
        until_us: int | None = None,
        after: tuple[int, int] | None = None,
        limit: int = 100,
        path: bool = True,
    ) -> list[Numbered]:
        """Return at most `limit` events of a surface and a kind, newest touch first; those of a clock ahead come last.

        Parameters
        ----------
        since_us, until_us : earliest touch, and the time that it is before [us since 1970]
        after : touch time and id of the last event that was read
        path : whether to read paths and captures too; they are by far the largest part of an event
        """
        query = select(_c.id, *(CONTENT if path else _WITHOUT_PATH))
        if surface is not None:
            query = query.where(_c.surface == surface)
        if kind is not None:
            query = query.where(_c.kind == kind)
        with self.database.reading() as connection:
            return [_event_of(row) for row in _newest(connection, query, since_us, until_us, limit, after)]

    def get(self, number: int) -> Event | None:
        """Return the event of that id; None if there is none."""
        with self.database.reading() as connection:
            row = connection.execute(select(_c.id, *CONTENT).where(_c.id == number)).first()
        return _event_of(row)[1] if row else None

    def best_samples(self, surface: str, since_us: int | None, until_us: int | None, limit: int) -> list[Sampled]:
        """Return the newest contacts of a surface that have a best sample, oldest first, by the time of their touch."""
        is_contact = _c.best["is_contact"].as_boolean()
        query = select(_c.id, _c.model, _c.best).where(_c.surface == surface, _c.best.is_not(null()), is_contact)
        with self.database.reading() as connection:
            rows = _newest(connection, query, since_us, until_us, limit)
        return [Sampled(row.id, row.model, Best.read(row.best)) for row in reversed(rows)]

    def due(self, destination: str, limit: int, *, from_start: bool) -> tuple[list[Due], int]:
        """Return finished events that a destination has yet to acknowledge, in order, and how many there are.

        A destination that the record does not know gets the events that finish from now on, or all.
        """
        is_due = DELIVERIES.c.destination == destination
        query = (
            select(DELIVERIES.c.number, _c.id, *_WITHOUT_PATH)
            .join(EVENTS, _c.id == DELIVERIES.c.event)
            .where(is_due)
            .order_by(DELIVERIES.c.number)
            .limit(limit)
        )
        with self.database.writing() as connection:
            _make_known(connection, destination, from_start=from_start)
            count = connection.scalar(select(func.count()).select_from(DELIVERIES).where(is_due)) or 0
            rows = connection.execute(query).all() if limit and count else []
        return [Due(row.number, *_event_of(row)) for row in rows], count

    def acknowledge(self, delivered: Collection[Due]) -> None:
        """Note that these events were acknowledged."""
        numbers = [one.delivery for one in delivered]
        with self.database.writing() as connection:
            connection.execute(delete(DELIVERIES).where(DELIVERIES.c.number.in_(numbers)))

    def close(self) -> None:
        """Close the connections."""
        self.database.close()


def _newest(
    connection: Connection,
    query: Select[Any],
    since_us: int | None,
    until_us: int | None,
    limit: int,
    after: tuple[int, int] | None = None,
) -> list[Row[*tuple[Any, ...]]]:
    """Return the newest rows of a query in a span of time, newest touch first; those of a clock ahead come last.

    On top they would hide all others for years.
    """
    if since_us is not None:
        query = query.where(_c.touched_us >= since_us)
    if until_us is not None:
        query = query.where(_c.touched_us < until_us)
    query = query.order_by(_c.touched_us.desc(), _c.id.desc())
    ahead_us = round((time.time() + AHEAD_S) * 1e6)
    following = tuple_(_c.touched_us, _c.id) < tuple_(*after) if after else true()
    parts = [query.where(_c.touched_us <= ahead_us, following), query.where(_c.touched_us > ahead_us)]
    if after and after[0] > ahead_us:
        parts = [parts[1].where(following)]
    rows: list[Row[*tuple[Any, ...]]] = []
    for part in parts:
        if len(rows) < limit:
            rows += connection.execute(part.limit(limit - len(rows))).all()
    return rows


def _find_lost(connection: Connection, changes: Sequence[Change]) -> set[str]:
    """Return the surfaces of which another service has written a row since this one read it."""
    boots = {(change.surface, boot.boot_id): boot.version for change in changes for boot in change.boots}
    is_of_boot = tuple_(CURSORS.c.surface, CURSORS.c.boot_id).in_(list(boots))
    cursors = connection.execute(select(CURSORS.c.surface, CURSORS.c.boot_id, CURSORS.c.version).where(is_of_boot))
    versions = {(surface, boot_id): version for surface, boot_id, version in cursors}
    lost = {surface for (surface, boot_id), before in boots.items() if versions.get((surface, boot_id), 0) != before}
    dirty = {change.surface: change.health.version for change in changes if change.health.is_dirty}
    healths = connection.execute(select(HEALTH.c.surface, HEALTH.c.version).where(HEALTH.c.surface.in_(list(dirty))))
    stands = {row.surface: row.version for row in healths}
    return lost | {surface for surface, before in dirty.items() if stands.get(surface, 0) != before}


def _write(connection: Connection, table: Table, rows: list[dict[str, Any]]) -> None:
    """Insert the rows that are written for the first time, and update the others."""
    if new := [row for row in rows if row["version"] == 1]:
        connection.execute(insert(table), new)
    if again := [row for row in rows if row["version"] > 1]:
        keys = [column.name for column in table.primary_key]
        is_row = [table.c[name] == bindparam(f"of_{name}") for name in keys]
        values = [{f"of_{name}": row[name] for name in keys} | row for row in again]
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
            again.append(values | {"of_id": number})
    if again:
        connection.execute(update(EVENTS).where(_c.id == bindparam("of_id")), again)
    finished = [numbers.get(event, number) for event, number, row in events if row["end"] is not End.OPEN]
    if finished:
        both = join(EVENTS, DESTINATIONS, true())
        each = select(DESTINATIONS.c.name, _c.id).select_from(both).where(_c.id.in_(finished)).order_by(_c.id)
        connection.execute(insert(DELIVERIES).from_select(["destination", "event"], each))
    return numbers


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


def _event_of(row: Row[*tuple[Any, ...]]) -> Numbered:
    """Return the event of a row of `CONTENT`, with or without its path."""
    values = {name: value for name, value in row._asdict().items() if name not in ("id", "number")}
    values["path"] = [tuple(point) for point in values.get("path", [])]
    return row.id, Event(**values)
