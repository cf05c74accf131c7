"""The best samples of stored events, and the baselines of health. Every call is part of a transaction."""

from dataclasses import dataclass
from typing import Any

from sqlalchemy import Connection, Row, Select, bindparam, delete, insert, null, select

from beamtouch_service.events.best_samples import Best
from beamtouch_service.events.schema import BASELINES, EVENTS, IS_OPEN
from beamtouch_service.events.segments import End

_c = EVENTS.c
_HAS_BEST = _c.best.is_not(null())
_IS_CONTACT = _c.best["is_contact"].as_boolean()
_CONTENT = [_c.id, _c.model, _c.best]
_of_surface = _c.surface == bindparam("of_surface")
_ENDED = (
    select(*_CONTENT, _c.end)
    .where(_of_surface, _c.id > bindparam("after"), _HAS_BEST | IS_OPEN)
    .order_by(_c.id)
    .limit(bindparam("max_events"))
)
_BASELINE = select(BASELINES).where(BASELINES.c.surface == bindparam("of_surface"))
_DROP = delete(BASELINES).where(BASELINES.c.surface == bindparam("of_surface"))
_KEEP = insert(BASELINES)


@dataclass(frozen=True)
class Sampled:
    """An event with its best sample."""

    number: int
    model: str
    best: Best | None
    """None if another version wrote it in another way."""


@dataclass(frozen=True)
class Baseline:
    """What the best samples of a surface add up to since its baseline began."""

    surface: str
    model: str
    characteristic: str | None
    last_event: int
    """The newest event in it."""
    newest_us: int
    """Time of the newest sample in it [us since 1970]."""
    history: dict[str, Any]


def contacts(
    connection: Connection, surface: str, since_us: int | None, until_us: int | None, limit: int
) -> list[Sampled]:
    """Return the newest contacts of a surface that have a best sample, oldest first, by the time of their touch."""
    query: Select[Any] = select(*_CONTENT).where(_of_surface, _HAS_BEST, _IS_CONTACT)
    if since_us is not None:
        query = query.where(_c.touched_us >= since_us)
    if until_us is not None:
        query = query.where(_c.touched_us < until_us)
    query = query.order_by(_c.touched_us.desc(), _c.id.desc()).limit(limit)
    return [_sampled(row) for row in connection.execute(query, {"of_surface": surface})][::-1]


def ended_after(connection: Connection, surface: str, number: int, max_events: int) -> list[Sampled]:
    """Return events with a best sample in the order of their ids, up to the first that is open."""
    found = []
    for row in connection.execute(_ENDED, {"of_surface": surface, "after": number, "max_events": max_events}):
        if row.end is End.OPEN:
            break
        found.append(_sampled(row))
    return found


def baseline(connection: Connection, surface: str) -> Baseline | None:
    """Return what is kept of a surface; None if nothing is."""
    row = connection.execute(_BASELINE, {"of_surface": surface}).first()
    return Baseline(**row._asdict()) if row else None


def keep(connection: Connection, kept: Baseline) -> None:
    """Keep a baseline instead of the one before."""
    connection.execute(_DROP, {"of_surface": kept.surface})
    connection.execute(_KEEP, vars(kept))


def _sampled(row: Row[*tuple[Any, ...]]) -> Sampled:
    return Sampled(row.id, row.model, Best.of(row.best))
