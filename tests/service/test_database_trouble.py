"""A database that freezes, becomes a standby, comes back with other tables, or loses an answer."""

from __future__ import annotations

import os
import signal
import socket
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING

import psycopg
import pytest

from beamtouch_service.events import database
from beamtouch_service.events.file import EventsAwayError
from beamtouch_service.events.losses import Losses
from beamtouch_service.events.segments import End, Segment
from beamtouch_service.events.selection import Selection
from beamtouch_service.events.store import EventStore
from beamtouch_service.events.writer import Writer
from losing_relay import relay_to
from postgres import Postgres, rows
from waiting import wait_until

if TYPE_CHECKING:
    from collections.abc import Iterator

BOOT = "boot-0001"
OLDER = "DROP TABLE edges; UPDATE beamtouch_format SET format = 5"
ALL_TABLES = "DROP TABLE events, captures, baselines, deliveries, edges, beamtouch_format"
UNBOUNDED = """
CREATE FUNCTION bounded() RETURNS event_trigger LANGUAGE plpgsql AS $$ BEGIN
    IF current_setting('statement_timeout') <> '0' THEN RAISE EXCEPTION 'a large table would take too long'; END IF;
END $$;
CREATE EVENT TRIGGER bounded ON ddl_command_start EXECUTE FUNCTION bounded()
"""


def segment(first: int, last: int, position_mm: float = 100.0) -> Segment:
    samples = last - first + 1
    span = (first, last, first * 5000, last * 5000)
    return Segment("press-7", "tiny@000000", BOOT, *span, samples=samples, position_sum_mm=samples * position_mm)


@pytest.fixture
def store(events_url: str) -> Iterator[EventStore]:
    store = EventStore(events_url, 86_400.0, 1_000_000)
    store.write("press-7", [segment(0, 9)], 0.0)
    yield store
    store.close()


def run(url: str, statement: str) -> None:
    with psycopg.connect(url, autocommit=True) as connection:
        connection.execute(statement.encode())


def end_connections(url: str) -> None:
    run(url, "SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE application_name = 'beamtouch-service'")


def spans(store: EventStore) -> list[tuple[int, int]]:
    return [(event.first_sequence, event.last_sequence) for _, event in store.read(Selection())]


def test_a_call_that_a_frozen_database_never_answers_is_ended(
    store: EventStore, events_url: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    query = "SELECT pid FROM pg_stat_activity WHERE application_name = 'beamtouch-service' AND datname = "
    ((pid,),) = rows(events_url, f"{query}'{events_url.rpartition('/')[2]}'")
    os.kill(pid, signal.SIGSTOP)
    try:
        with ThreadPoolExecutor(1) as thread:
            writing = thread.submit(store.write, "press-7", [segment(10, 19)], 0.0)
            store.abandon_stuck()  # not yet
            monkeypatch.setattr(database, "STUCK_S", 0.0)

            def is_over() -> bool:
                store.abandon_stuck()
                return writing.done()

            wait_until(is_over)
            assert isinstance(writing.exception(), EventsAwayError)
    finally:
        os.kill(pid, signal.SIGCONT)
    monkeypatch.undo()
    store.write("press-7", [segment(10, 19)], 0.0)
    assert spans(store) == [(0, 19)]


def test_the_socket_of_an_ended_connection_is_not_taken_for_another(store: EventStore, events_url: str) -> None:
    end_connections(events_url)
    with pytest.raises(EventsAwayError):
        store.write("press-7", [segment(10, 19)], 0.0)
    others = [socket.socketpair() for _ in range(8)]  # one of them has its number
    store.abandon()
    for one, other in others:
        with one, other:
            one.sendall(b"!")
            assert other.recv(1) == b"!"


def test_a_standby_takes_no_events_and_loses_none(store: EventStore, events_url: str) -> None:
    name = events_url.rpartition("/")[2]
    run(events_url, f"ALTER DATABASE {name} SET default_transaction_read_only = on")
    end_connections(events_url)
    for _ in range(2):  # the connection that was ended, and one to the standby
        with pytest.raises(EventsAwayError):
            store.write("press-7", [segment(10, 19)], 0.0)
    assert spans(store) == [(0, 9)]
    with psycopg.connect(events_url, autocommit=True) as connection:
        connection.execute("SET default_transaction_read_only = off")
        connection.execute(f"ALTER DATABASE {name} RESET default_transaction_read_only".encode())
    end_connections(events_url)
    writer = Writer(store, Losses(), lambda _surface: None)
    writer.write_new("press-7", lambda: [segment(10, 19)])
    wait_until(writer.drain)
    assert spans(store) == [(0, 19)]


@pytest.mark.parametrize("change", [OLDER, ALL_TABLES, "ALTER TABLE events DROP COLUMN best"])
def test_tables_that_change_under_an_open_connection_cost_no_write(
    store: EventStore, events_url: str, change: str
) -> None:
    run(events_url, change)
    if "COLUMN" in change:
        run(events_url, f"{OLDER}; ALTER TABLE events DROP COLUMN change; DROP INDEX IF EXISTS by_change")
        run(events_url, "DROP TABLE baselines, deliveries; ALTER TABLE events DROP COLUMN unsteady")
        run(events_url, "UPDATE beamtouch_format SET format = 3")
    losses = Losses()
    writer = Writer(store, losses, lambda _surface: None)
    writer.write_new("press-7", lambda: [segment(20, 29)])
    wait_until(writer.drain)
    assert losses.count == 0
    assert (20, 29) in spans(store)
    assert rows(events_url, "SELECT format, (SELECT count(*) FROM edges) FROM beamtouch_format") == [(6, 0)]


def test_an_upgrade_may_take_as_long_as_it_takes(store: EventStore, events_url: str) -> None:
    run(events_url, OLDER)
    run(events_url, UNBOUNDED)
    newer = EventStore(events_url, 86_400.0, 1_000_000)
    assert spans(newer) == spans(store) == [(0, 9)]
    newer.close()


def test_a_write_whose_answer_was_lost_is_not_counted_twice(postgres: Postgres, events_url: str) -> None:
    with relay_to(postgres.port) as relay:
        store = EventStore(events_url.replace(f":{postgres.port}/", f":{relay.port}/"), 86_400.0, 1_000_000)
        writer = Writer(store, Losses(), lambda _surface: None)
        relay.lose.set()
        writer.write_new("press-7", lambda: [segment(0, 9, 100.0)])
        assert writer.waiting == 1
        assert rows(events_url, "SELECT last_sequence FROM events") == [(9,)]
        writer.write_new("press-7", lambda: [segment(10, 19, 50.0)])
        wait_until(writer.drain)
        ((_, event),) = store.read(Selection())
        assert (event.first_sequence, event.last_sequence, event.samples, event.end) == (0, 19, 20, End.OPEN)
        assert event.position_sum_mm == 1500
        store.close()
