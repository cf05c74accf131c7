"""Upgrades of the record of events, from every format there was, in SQLite and in PostgreSQL."""

from __future__ import annotations

import sqlite3
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import psycopg
import pytest

from beamtouch_models.modelfile import Memory, State
from beamtouch_service.events.findings import Edge
from beamtouch_service.events.schema import FORMAT
from beamtouch_service.events.segments import Begin, End, EventKind, Segment
from beamtouch_service.events.selection import Selection
from beamtouch_service.events.store import EventStore
from beamtouch_service.surfaces.follower import Past
from postgres import rows
from service.test_event_store import DAY_S, segment

OLDER = range(1, FORMAT)
TO_OLDER = {
    5: ["DROP TABLE edges"],
    4: ["DROP TABLE deliveries", "DROP INDEX by_change", "ALTER TABLE events DROP COLUMN change"],
    3: ["DROP TABLE baselines", "ALTER TABLE events DROP COLUMN best, DROP COLUMN unsteady"],
    2: [
        "DROP TABLE captures",
        "ALTER TABLE events DROP COLUMN kind, DROP COLUMN unexplained_us, DROP COLUMN ends_unexplained",
    ],
    1: ["DROP INDEX by_open"],
}
"""What a format lacks of the next one. No service ever wrote PostgreSQL in them."""
BROKER = "mqtt://127.0.0.1:1883/beamtouch"


def old_file(path: Path, number: int) -> None:
    """Make a file as a service of an older format left it at a kill."""
    with closing(sqlite3.connect(path)) as older:
        older.executescript(Path(__file__).with_name(f"events_format_{number}.sql").read_text())


def opened(place: Path | str) -> EventStore:
    return EventStore(place, 100_000 * DAY_S, 1_000_000)


def clear_after(event: Segment) -> Edge:
    past = Past((Memory(State.CLEAR, armed=True),))
    return Edge(event.boot_id, event.model, event.last_sequence + 1, event.last_us + 5000, State.CLEAR, past)


def schema(path: Path) -> dict[str, list[tuple[object, ...]]]:
    """Names, types, defaults of the columns of each table, and the indexes."""
    with closing(sqlite3.connect(path)) as file:
        tables = [name for (name,) in file.execute("SELECT name FROM sqlite_master WHERE type = 'table'")]
        found = {name: sorted(row[1:5] for row in file.execute(f"PRAGMA table_info({name})")) for name in tables}
        return found | {"indexes": sorted(file.execute("SELECT name FROM sqlite_master WHERE type = 'index'"))}


@pytest.mark.parametrize("number", OLDER)
def test_a_file_of_an_older_format_gets_what_a_new_one_has_and_keeps_its_events(tmp_path: Path, number: int) -> None:
    path, new = tmp_path / "older.db", tmp_path / "new.db"
    old_file(path, number)
    opened(new).close()

    store = opened(path)
    (highest, left_open), (_, lifted) = store.read(Selection())
    assert (lifted.begin, lifted.end, left_open.end) == (Begin.TOUCH, End.LIFT, End.UNFINISHED)
    # Whatever the format, what is new now works: a clear sample next to a gap ends the event before it.
    store.write("press-7", [clear_after(left_open)], 0.0)
    store.write("press-7", [replace(left_open, touched_us=2**60, first_sequence=90, last_sequence=99)], 0.0)
    (newest, _), (_, lifted_too), _ = store.read(Selection())
    assert (newest, lifted_too.end) == (highest + 1, End.LIFT)
    store.close()
    assert (
        schema(path).items()
        >= {name: columns for name, columns in schema(new).items() if number > 1 or name != "events"}.items()
    )
    with closing(sqlite3.connect(path)) as file:
        assert file.execute("PRAGMA user_version").fetchone() == (FORMAT,)


def test_what_a_broker_has_acknowledged_is_not_due_after_an_upgrade(tmp_path: Path) -> None:
    path = tmp_path / "older.db"
    old_file(path, 5)
    store = opened(path)
    # The open event is finished now, and due. The other one was acknowledged.
    assert [one.number for one in store.due(BROKER, 10)[0]] == [2]
    store.close()


def test_a_contact_that_was_open_before_an_upgrade_goes_on(tmp_path: Path) -> None:
    path = tmp_path / "older.db"
    old_file(path, 2)
    store = opened(path)
    first = store.get(1)
    assert first is not None
    assert (len(first.path), first.unexplained_us, first.ends_unexplained, store.capture(first)) == (3, 0, False, [])
    goes_on = replace(
        segment(8, 9), model=first.model, touched_us=first.touched_us + 30_000, kind=EventKind.UNEXPLAINED
    )
    store.write("press-7", [replace(goes_on, samples=0, unexplained_us=5000, ends_unexplained=True)], 0.0)
    assert [(kept.last_sequence, kept.end, kept.kind) for _, kept in store.read(Selection(limit=1))] == [
        (9, "open", "contact")
    ]
    store.close()


def of_format(url: str, number: int) -> None:
    """Make a database with one event, and take from it what a format lacks."""
    store = opened(url)
    store.write("press-7", [segment(0, 9, end=End.UNSEEN)], 0.0)
    store.close()
    with psycopg.connect(url) as connection:
        for step in range(FORMAT - 1, number - 1, -1):
            for statement in TO_OLDER[step]:
                connection.execute(statement.encode())
        connection.execute("UPDATE beamtouch_format SET format = %s", (number,))


def described(url: str) -> list[tuple[object, ...]]:
    columns = "SELECT table_name, column_name, data_type, is_nullable, column_default FROM information_schema.columns"
    found = rows(url, f"{columns} WHERE table_schema = 'public' ORDER BY 1, 2")
    return found + rows(url, "SELECT indexname FROM pg_indexes WHERE schemaname = 'public' ORDER BY 1")


@pytest.mark.parametrize("number", OLDER)
def test_a_database_of_an_older_format_is_upgraded_by_one_of_two_services(events_url: str, number: int) -> None:
    opened(events_url).close()
    new = described(events_url)
    of_format(events_url, number)

    with ThreadPoolExecutor(2) as threads:
        found = list(threads.map(opened, [events_url] * 2))
    ((_, event),) = found[0].read(Selection())
    found[1].write("press-7", [clear_after(event)], 0.0)
    ((_, event),) = found[0].read(Selection())
    assert (event.last_sequence, event.end) == (9, End.LIFT)
    assert described(events_url) == new
    assert rows(events_url, "SELECT format FROM beamtouch_format") == [(FORMAT,)]
    for one in found:
        one.close()
