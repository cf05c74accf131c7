"""Events that a destination has yet to acknowledge."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from typing import TYPE_CHECKING

import pytest

from beamtouch_service.events.findings import Finish
from beamtouch_service.events.segments import End
from beamtouch_service.events.store import EventStore
from service.test_event_store import DAY_S, segment
from service.test_event_upgrades import old_file

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

BROKER = "mqtt://127.0.0.1:1883/beamtouch"


def opened(path: Path) -> EventStore:
    return EventStore(path, 30 * DAY_S, 10**8)


@pytest.fixture
def store(tmp_path: Path) -> Iterator[EventStore]:
    store = opened(tmp_path / "events.db")
    yield store
    store.close()


def due(store: EventStore, limit: int = 10) -> list[tuple[int, End]]:
    found, count = store.due(BROKER, limit)
    assert len(found) == min(count, limit)
    return [(one.number, one.event.end) for one in found]


def acknowledge(store: EventStore, limit: int = 10) -> None:
    store.acknowledge(BROKER, store.due(BROKER, limit)[0][-1])


def test_finished_events_are_due_in_the_order_of_their_ends(store: EventStore) -> None:
    store.begin_delivery(BROKER, from_start=False)
    store.write("press-7", [segment(1, 5)], 0.0)
    # A late event comes to its end before the one that is open.
    store.write("press-7", [segment(10, 12, end=End.UNSEEN)], 0.0)
    assert due(store) == [(2, End.UNSEEN)]
    acknowledge(store)
    store.write("press-7", [Finish("boot-0001", 5, End.LIFT, 30_000)], 0.0)
    assert due(store) == [(1, End.LIFT)]
    acknowledge(store)
    assert due(store) == []


def test_a_new_destination_begins_now_or_at_the_start(store: EventStore) -> None:
    store.write("press-7", [segment(1, 5, end=End.LIFT)], 0.0)
    store.begin_delivery(BROKER, from_start=False)
    store.begin_delivery("other", from_start=True)
    assert due(store) == []
    assert store.due("other", 10)[1] == 1
    store.begin_delivery(BROKER, from_start=True)  # it is known already
    assert due(store) == []
    store.write("press-7", [segment(11, 15, end=End.LIFT)], 0.0)
    assert due(store) == [(2, End.LIFT)]
    assert [one.number for one in store.due("other", 1)[0]] == [1]


def test_what_was_acknowledged_is_known_after_a_restart(tmp_path: Path) -> None:
    path = tmp_path / "restarted.db"
    store = opened(path)
    store.begin_delivery(BROKER, from_start=False)
    store.write("press-7", [segment(10 * i, 10 * i + 5, end=End.LIFT) for i in range(5)], 0.0)
    acknowledge(store, limit=2)
    # It is open when the service stops.
    store.write("press-7", [segment(100, 105)], 0.0)
    store.close()

    store = opened(path)
    store.begin_delivery(BROKER, from_start=False)
    assert due(store) == [(3, End.LIFT), (4, End.LIFT), (5, End.LIFT), (6, End.UNFINISHED)]
    acknowledge(store)
    store.close()
    store = opened(path)
    assert due(store) == []
    store.close()


def test_an_event_that_changes_is_due_again(store: EventStore) -> None:
    store.begin_delivery(BROKER, from_start=False)
    store.write("press-7", [segment(1, 5, end=End.STALE), segment(9, 12, end=End.LIFT)], 0.0)
    acknowledge(store)
    # Late samples fill the gap: the second event is gone, and the first one is longer.
    store.write("press-7", [segment(6, 8, end=End.UNSEEN)], 0.0)
    assert due(store) == [(1, End.LIFT)]
    (one,), _ = store.due(BROKER, 10)
    assert (one.event.first_sequence, one.event.last_sequence) == (1, 12)


def test_a_change_while_the_event_is_on_its_way_is_due_again(store: EventStore) -> None:
    store.begin_delivery(BROKER, from_start=False)
    store.write("press-7", [segment(1, 5, end=End.UNSEEN), segment(9, 12, end=End.UNSEEN)], 0.0)
    sent, _ = store.due(BROKER, 10)
    # The newest change disappears with its event, and its number must not come again.
    store.write("press-7", [segment(6, 8, end=End.UNSEEN)], 0.0)
    store.acknowledge(BROKER, sent[-1])
    assert due(store) == [(1, End.UNSEEN)]


def test_events_of_one_change_are_due_one_by_one(store: EventStore, tmp_path: Path) -> None:
    store.begin_delivery(BROKER, from_start=False)
    store.write("press-7", [segment(1, 5, end=End.LIFT), segment(9, 12, end=End.LIFT)], 0.0)
    with closing(sqlite3.connect(tmp_path / "events.db")) as file:  # the store has no such write
        file.execute("UPDATE events SET change = 7")
        file.commit()
    acknowledge(store, limit=1)
    assert due(store) == [(2, End.LIFT)]


def test_events_of_an_older_file_are_due_from_the_start(tmp_path: Path) -> None:
    path = tmp_path / "older.db"
    old_file(path, 1)
    store = opened(path)
    store.begin_delivery(BROKER, from_start=True)
    assert due(store) == [(7, End.LIFT), (8, End.UNFINISHED)]
    store.close()
