"""Events that a destination has yet to acknowledge. Every call is part of a transaction.

An event that changes after it was acknowledged is due again: samples may return to an event that had ended, and late
samples join two events.
"""

from typing import NamedTuple

from sqlalchemy import ColumnElement, Connection, func, insert, select, tuple_, update

from beamtouch_service.events import capture_table, writing
from beamtouch_service.events.schema import DELIVERIES, EVENTS, IS_FINISHED
from beamtouch_service.events.segments import Segment

_HIGHEST = 2**63 - 1
_c = EVENTS.c


class Due(NamedTuple):
    """A finished event that a destination has yet to acknowledge."""

    change: int
    """Number of its last change."""
    number: int
    """Id of the event."""
    event: Segment
    captured: bool
    """Whether samples of it are kept."""


def begin(connection: Connection, destination: str, *, from_start: bool) -> None:
    """Make a destination known: from now on, or from the start of the record. A known one stays as it is."""
    if connection.execute(select(DELIVERIES).where(_is(destination))).first():
        return
    newest = 0 if from_start else connection.scalar(select(func.max(_c.change))) or 0
    values = {"destination": destination, "change": newest, "event": 0 if from_start else _HIGHEST}
    connection.execute(insert(DELIVERIES).values(values))


def due(connection: Connection, destination: str, limit: int) -> list[Due]:
    """Return finished events that this destination has yet to acknowledge, in the order of their changes."""
    content = [column for column in writing.CONTENT if column is not _c.path]
    query = select(_c.change, *content).where(_is_due(connection, destination)).order_by(_c.change, _c.id).limit(limit)
    found = [(row[0], *writing.numbered(row)) for row in connection.execute(query)]
    captured = capture_table.captured(connection, [number for _, number, _ in found])
    return [Due(change, number, event, number in captured) for change, number, event in found]


def count(connection: Connection, destination: str) -> int:
    """Return the number of these events."""
    query = select(func.count()).select_from(EVENTS).where(_is_due(connection, destination))
    return connection.scalar(query) or 0


def acknowledge(connection: Connection, destination: str, last: Due) -> None:
    """Note that a destination has acknowledged all changes up to this one."""
    values = {"change": last.change, "event": last.number}
    connection.execute(update(DELIVERIES).where(_is(destination)).values(values))


def _is(destination: str) -> ColumnElement[bool]:
    return DELIVERIES.c.destination == destination


def _is_due(connection: Connection, destination: str) -> ColumnElement[bool]:
    row = connection.execute(select(DELIVERIES.c.change, DELIVERIES.c.event).where(_is(destination))).one()
    return IS_FINISHED & (tuple_(_c.change, _c.id) > tuple_(row.change, row.event))
