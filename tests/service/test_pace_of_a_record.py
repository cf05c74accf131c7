"""For how many days a record keeps its events at a pace, and when a record is large enough to tell its own."""

import sqlite3
from contextlib import closing
from pathlib import Path

import pytest

from beamtouch_service.record.forecast import Pace, kept_days, pace_of
from beamtouch_service.sections import EventsSection

HOUR_US = 3_600_000_000


def record_of(folder: Path, events: int, span_us: int) -> Path:
    """Return a record of so many events, the last of which began so long after the first."""
    path = folder / "events.db"
    with closing(sqlite3.connect(path)) as connection:
        connection.execute("CREATE TABLE events (touched_us INTEGER)")
        times_us = [*[0] * (events - 1), span_us]
        connection.executemany("INSERT INTO events VALUES (?)", [(time_us,) for time_us in times_us])
        connection.commit()
    return path


def test_events_are_kept_for_the_days_that_are_stated_or_that_the_size_holds() -> None:
    section = EventsSection(keep_days=10, max_mb=86.4)
    assert kept_days(section, Pace(event_bytes=1000.0, every_s=20.0)) == 10
    assert kept_days(section, Pace(event_bytes=1000.0, every_s=2.0)) == 2.0
    assert kept_days(section, Pace(event_bytes=500.0, every_s=2.0)) == 4.0


@pytest.mark.parametrize(
    ("events", "span_us", "tells"),
    [(100, HOUR_US, True), (99, HOUR_US, False), (100, HOUR_US - 1, False)],
)
def test_a_record_of_a_hundred_events_over_an_hour_tells_its_pace(
    tmp_path: Path, events: int, span_us: int, tells: bool
) -> None:
    pace = pace_of(record_of(tmp_path, events, span_us))
    if tells:
        assert pace == Pace(event_bytes=2 * 4096 / 100, every_s=36.0)  # two pages
    else:
        assert pace is None


def test_what_is_no_record_tells_nothing(tmp_path: Path) -> None:
    assert pace_of(tmp_path / "absent.db") is None
    assert not (tmp_path / "absent.db").exists()
