"""Queries for the readers of the record."""

import time
from dataclasses import dataclass
from typing import Any

from sqlalchemy import Row, Select, null, select, true, tuple_

from beamtouch_service.record.database.tables import CONTENT, EVENTS, WITHOUT_PATH, event_of
from beamtouch_service.record.events.best import Best
from beamtouch_service.record.events.event import Event, EventKind, Numbered
from beamtouch_service.record.events.times import latest_us
from beamtouch_service.record.reading.readers import Reader

_c = EVENTS.c


@dataclass(frozen=True)
class Sampled:
    """An event with its best sample."""

    number: int
    model: str
    best: Best | None


def find_events(
    reader: Reader,
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
    query = select(_c.id, *(CONTENT if path else WITHOUT_PATH))
    if surface is not None:
        query = query.where(_c.surface == surface)
    if kind is not None:
        query = query.where(_c.kind == kind)
    return [event_of(row) for row in _newest(reader, query, since_us, until_us, limit, after)]


def get_event(reader: Reader, number: int) -> Event | None:
    """Return the event of that id; None if there is none."""
    rows = reader.rows(select(_c.id, *CONTENT).where(_c.id == number))
    return event_of(rows[0])[1] if rows else None


def find_best_samples(
    reader: Reader, surface: str, since_us: int | None, until_us: int | None, limit: int
) -> list[Sampled]:
    """Return the newest contacts of a surface that have a best sample, oldest first, by the time of their touch."""
    is_contact = _c.best["is_contact"].as_boolean()
    query = select(_c.id, _c.model, _c.best).where(_c.surface == surface, _c.best.is_not(null()), is_contact)
    rows = _newest(reader, query, since_us, until_us, limit)
    return [Sampled(row.id, row.model, Best.read(row.best)) for row in reversed(rows)]


def _newest(
    reader: Reader,
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
    ahead_us = latest_us(time.time())
    following = tuple_(_c.touched_us, _c.id) < tuple_(*after) if after else true()
    parts = [query.where(_c.touched_us <= ahead_us, following), query.where(_c.touched_us > ahead_us)]
    if after and after[0] > ahead_us:
        parts = [parts[1].where(following)]
    rows: list[Row[*tuple[Any, ...]]] = []
    for part in parts:
        if len(rows) < limit:
            rows += reader.rows(part.limit(limit - len(rows)))
    return rows
