"""`beamtouch-service check` says for how many days the limits of the record keep its events."""

import json
import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from beamtouch_service import cli
from beamtouch_service.record.forecast import Pace, kept_days, pace_of
from beamtouch_service.sections import EventsSection
from service.bench import Bench, surface_of
from service.event_story import RESTING, TOUCHING
from service.record_file import execute

BUSY = "at a contact each 2 s"


def check(folder: Path, section: str, capsys: pytest.CaptureFixture[str]) -> tuple[list[str], dict[str, Any]]:
    """Return the lines on events of `check`, and what it says of them as JSON."""
    path = folder / "service.toml"
    path.write_text(f"[events]\n{section}\n")
    assert cli.main(["check", "--config", str(path)]) == 0
    lines = [line for line in capsys.readouterr().out.splitlines() if line.startswith("events:")]
    assert cli.main(["check", "--config", str(path), "--json"]) == 0
    return lines, json.loads(capsys.readouterr().out)["events"]


@pytest.mark.promise("docs/reference/events.md", "so the default of `max_mb` holds one each 2 s for 30 days")
@pytest.mark.promise(
    "docs/reference/service-configuration.md",
    "1200 in a file or a database, which holds a contact each 2 s for 30 days",
)
def test_the_defaults_keep_a_contact_each_2_s_for_30_days(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lines, days = check(tmp_path, 'file = "events.db"', capsys)
    assert lines == [f"events: kept for 30 days {BUSY} (keep_days)"]
    assert days == {"busy_days": 30.0}
    assert not (tmp_path / "events.db").exists()


def test_a_size_that_is_too_small_is_said_with_its_days(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lines, _ = check(tmp_path, 'file = "events.db"\nmax_mb = 100', capsys)
    assert lines == [f"events: kept for 2.89 days {BUSY} (max_mb = 100)"]
    # In memory.
    assert check(tmp_path, "keep_days = 30", capsys)[0] == lines


@pytest.mark.promise("docs/reference/events.md", "and at the pace of a record that is there")
def test_a_record_says_its_own_pace(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "events.db"
    bench = Bench(surface_of(), events=EventsSection(file=file))
    rows = [RESTING, TOUCHING] * 150
    bench.send(*rows, every_us=20_000_000)
    assert bench.get("/events").status_code == 200
    (busy, own), days = check(tmp_path, 'file = "events.db"\nmax_mb = 1', capsys)
    assert busy == f"events: kept for 0.0289 days {BUSY} (max_mb = 1)"
    assert own.startswith("events: kept for 0.")
    assert own.endswith(" days at the pace of the record, an event each 39.7 s (max_mb = 1)")
    # An event of three channels takes some 400 to 1200 bytes.
    assert 1e6 / 1200 * 39.7 / 86_400 < days["own_days"] < 1e6 / 400 * 39.7 / 86_400
    file = tmp_path / "other.db"
    file.write_bytes(b"no database")
    assert check(tmp_path, 'file = "other.db"\nmax_mb = 1', capsys)[0] == [busy]


def test_room_that_deleted_events_left_counts_for_none(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "events.db"
    bench = Bench(surface_of(), events=EventsSection(file=file))
    bench.send(*[RESTING, TOUCHING] * 250, every_us=20_000_000)
    bench.get("/events")
    _, before = check(tmp_path, 'file = "events.db"\nmax_mb = 1', capsys)
    execute(file, "DELETE FROM events WHERE id <= 125")
    _, after = check(tmp_path, 'file = "events.db"\nmax_mb = 1', capsys)
    assert after["own_days"] == pytest.approx(before["own_days"], rel=0.4)


def record_of(path: Path, events: int, lasts_us: int) -> Path:
    """Make a file with so many events, the last one so long after the first."""
    with closing(sqlite3.connect(path)) as connection:
        connection.execute("CREATE TABLE events (touched_us INTEGER, filler TEXT)")
        rows = [(7_000_000 + lasts_us * number // (events - 1), "x" * 500) for number in range(events)]
        connection.executemany("INSERT INTO events VALUES (?, ?)", rows)
        connection.commit()
    return path


def test_a_record_says_its_pace_from_a_hundred_events_and_an_hour_on(tmp_path: Path) -> None:
    hour_us = 3_600_000_000
    path = record_of(tmp_path / "events.db", 100, hour_us)
    assert pace_of(path) == Pace(path.stat().st_size / 100, 36.0)
    assert pace_of(record_of(tmp_path / "few.db", 99, hour_us)) is None
    assert pace_of(record_of(tmp_path / "short.db", 100, hour_us - 1)) is None
    assert pace_of(tmp_path / "none.db") is None


def test_events_are_kept_for_as_long_as_both_limits_allow() -> None:
    """At 700 bytes an event, 3.5 MB hold 5000 of them: one each 17.28 s is a day."""
    events = EventsSection(keep_days=3, max_mb=3.5)
    assert kept_days(events, Pace(700.0, 17.28)) == pytest.approx(1.0)
    assert kept_days(events, Pace(350.0, 17.28 * 1.25)) == pytest.approx(2.5)
    assert kept_days(events, Pace(350.0, 17.28 * 2)) == 3.0
