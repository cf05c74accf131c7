"""Queries for the readers of the record.

What may be large is read in two steps: the keys of its events, and then its content, a few events at a time.
"""

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from sqlalchemy import ColumnElement, Row, Select, bindparam, null, select, true, tuple_

from beamtouch_common.outline import BEAM_AXES
from beamtouch_service.record.database.tables import CONTENT, EVENTS, WITHOUT_PATH, event_of, require_whole_event
from beamtouch_service.record.events.best import Best
from beamtouch_service.record.events.event import EventKind, Numbered
from beamtouch_service.record.events.times import latest_us
from beamtouch_service.record.reading.readers import Reader

AT_ONCE, AT_ONCE_WITH_PATH = 100, 25
"""Events that are read at a time: those with a path are some ten times as large, up to 10 kB."""
EventKey = Row[*tuple[Any, ...]]
"""`touched_us` and `id` of an event: its place in the order of touches."""
_c = EVENTS.c
_IS_ASKED = _c.id.in_(bindparam("ids", expanding=True))
# Made once: making a statement takes the interpreter for longer than running it.
_EVENTS = select(_c.id, *WITHOUT_PATH).where(_IS_ASKED)
_EVENTS_WITH_PATH = select(_c.id, *CONTENT).where(_IS_ASKED)
_PLACES = select(_c.id, _c.surface, _c.place).where(_IS_ASKED)
_BEST_SAMPLES = select(_c.id, _c.surface, _c.model, _c.best).where(_IS_ASKED)


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
) -> list[EventKey]:
    """Return at most `limit` events of a surface and a kind, newest touch first; those of a clock ahead come last.

    Parameters
    ----------
    since_us, until_us : earliest touch, and the time that it is before [us since 1970]
    after : touch time and id of the last event that was read
    """
    of_surface = true() if surface is None else _c.surface == surface
    of_kind = true() if kind is None else _c.kind == kind
    return _find_newest(reader, of_surface & of_kind, since_us, until_us, limit, after)


def read_events(reader: Reader, keys: Sequence[EventKey], *, path: bool) -> Iterator[Iterator[Numbered]]:
    """Give the events of these keys, some at a time, in their order; those that were deleted meanwhile are left out.

    Each is made when it is taken, so that the reader can rest between two of them.

    Parameters
    ----------
    path : whether to read paths and captures too; they are by far the largest part of an event
    """
    query, at_once = (_EVENTS_WITH_PATH, AT_ONCE_WITH_PATH) if path else (_EVENTS, AT_ONCE)
    for rows in _read(reader, query, keys, at_once):
        yield map(event_of, rows)


def find_axes(reader: Reader, keys: Sequence[EventKey]) -> list[tuple[str, ...]]:
    """Return the different axes of the events of these keys; without events, those of a beam."""
    axes: dict[tuple[str, ...], None] = {}
    for row in reader.rows(_PLACES, ids=[key.id for key in keys]):
        require_whole_event(row)
        axes[tuple(row.place)] = None
        reader.rest()
    return list(axes) or [BEAM_AXES]


def get_recorded_event(reader: Reader, number: int) -> Numbered | None:
    """Return the event of that id; None if there is none."""
    rows = reader.rows(_EVENTS_WITH_PATH, ids=[number])
    return event_of(rows[0]) if rows else None


def find_best_samples(
    reader: Reader, surface: str, since_us: int | None, until_us: int | None, limit: int
) -> list[EventKey]:
    """Return the newest contacts of a surface that have a best sample, oldest first, by the time of their touch."""
    is_contact = _c.best["is_contact"].as_boolean()
    condition = (_c.surface == surface) & _c.best.is_not(null()) & is_contact
    return _find_newest(reader, condition, since_us, until_us, limit)[::-1]


def read_best_samples(reader: Reader, keys: Sequence[EventKey]) -> Iterator[Iterator[Sampled]]:
    """Give the best samples of the events of these keys, as `read_events` gives those."""
    for rows in _read(reader, _BEST_SAMPLES, keys, AT_ONCE):
        yield map(_sampled_of, rows)


def _sampled_of(row: Row[*tuple[Any, ...]]) -> Sampled:
    require_whole_event(row)
    return Sampled(row.id, row.model, Best.read(row.best))


def _read(
    reader: Reader, query: Select[Any], keys: Sequence[EventKey], at_once: int
) -> Iterator[list[Row[*tuple[Any, ...]]]]:
    """Give the rows of these keys, some at a time. No transaction is open between two of them."""
    for first in range(0, len(keys), at_once):
        numbers = [key.id for key in keys[first : first + at_once]]
        rows = {row.id: row for row in reader.rows(query, ids=numbers)}
        yield [rows[number] for number in numbers if number in rows]


def _find_newest(
    reader: Reader,
    condition: ColumnElement[bool],
    since_us: int | None,
    until_us: int | None,
    limit: int,
    after: tuple[int, int] | None = None,
) -> list[EventKey]:
    """Return the newest events that fulfil a condition in a span of time, newest touch first.

    Those of a clock ahead come last: on top they would hide all others for years.
    """
    query = select(_c.touched_us, _c.id).where(condition)
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
    keys: list[EventKey] = []
    for part in parts:
        if len(keys) < limit:
            keys += reader.rows(part.limit(limit - len(keys)))
    return keys
