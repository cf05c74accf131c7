"""For how long the record keeps its events, by its limits: age and size."""

import sqlite3
from contextlib import closing
from pathlib import Path
from typing import NamedTuple

from beamtouch_service.sections import EventsSection

EVENT_BYTES = 800
"""Bytes of a contact of four channels in a SQLite file, with its indexes (docs/figures.md)."""
EVERY_S = 2.0
"""Time from one contact to the next on a busy surface."""
_DAY_S = 86_400.0
_LEAST_EVENTS, _LEAST_S = 100, 3600.0
"""A record with less says nothing of its pace."""


class Pace(NamedTuple):
    """The size of an event on record, and how often one comes."""

    event_bytes: float
    every_s: float


def kept_days(events: EventsSection, pace: Pace) -> float:
    """Return for how many days a record at this pace keeps its events."""
    return min(events.keep_days, events.largest_mb * 1e6 / pace.event_bytes * pace.every_s / _DAY_S)


def pace_of(path: Path) -> Pace | None:
    """Return the pace of a record in a SQLite file; None if there is none, or it cannot be read or holds too little."""
    try:
        with closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True)) as connection:
            count, first_us, last_us = connection.execute(
                "SELECT count(*), min(touched_us), max(touched_us) FROM events"
            ).fetchone()
            names = ("page_count", "freelist_count", "page_size")
            pages, free, size = (connection.execute(f"PRAGMA {name}").fetchone()[0] for name in names)
    except sqlite3.Error:
        return None
    if count < _LEAST_EVENTS or last_us - first_us < _LEAST_S * 1e6:
        return None
    return Pace((pages - free) * size / count, (last_us - first_us) / 1e6 / count)


def describe_kept_days(events: EventsSection) -> tuple[dict[str, float], list[str]]:
    """Return for how many days events are kept, and that in words: at a contact each 2 s, and at the record's pace."""
    own = pace_of(events.file) if events.file else None
    busy = Pace(EVENT_BYTES, EVERY_S)
    days, lines = {"busy_days": kept_days(events, busy)}, [_words(events, busy, f"a contact each {EVERY_S:g} s")]
    if own:
        days["own_days"] = kept_days(events, own)
        lines.append(_words(events, own, f"the pace of the record, an event each {own.every_s:.3g} s"))
    return days, lines


def _words(events: EventsSection, pace: Pace, at: str) -> str:
    days = kept_days(events, pace)
    by = "keep_days" if days >= events.keep_days else f"max_mb = {events.largest_mb:g}"
    return f"events: kept for {days:.3g} days at {at} ({by})"
