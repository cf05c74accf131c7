"""The file of events: bounded, whole after a crash, and honest about what it did not see."""

from __future__ import annotations

import shutil
import sqlite3
from typing import TYPE_CHECKING

import pytest

from beamtouch_service.events.pieces import Begin, End, Piece
from beamtouch_service.events.segmenter import Finish
from beamtouch_service.events.store import EventStore, EventStoreError, Selection

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

DAY_S = 86_400.0


def piece(first: int, last: int, *, end: End = End.OPEN, points: int = 1) -> Piece:
    return Piece(
        "press-7",
        "tiny@000000",
        "boot-0001",
        first,
        last,
        first * 5000,
        last * 5000,
        begin=Begin.UNSEEN,
        end=end,
        samples=last - first + 1,
        position_sum_mm=100.0 * (last - first + 1),
        path=[(first * 5000 + i, 100.0, 5.0) for i in range(points)],
    )


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "events.db"


@pytest.fixture
def store(path: Path) -> Iterator[EventStore]:
    store = EventStore(path, keep_s=30 * DAY_S, most_bytes=1_000_000)
    yield store
    store.close()


def spans(store: EventStore) -> list[tuple[int, int, int, str]]:
    found = [kept for _, kept in store.read(Selection())]
    return [(kept.first_sequence, kept.last_sequence, kept.samples, kept.end.value) for kept in reversed(found)]


def test_pieces_that_meet_are_one_in_any_order(store: EventStore) -> None:
    for part in (piece(20, 29), piece(0, 9, end=End.UNSEEN), piece(10, 19, end=End.UNSEEN)):
        store.write("press-7", [part], 0.0)

    assert spans(store) == [(0, 29, 30, "open")]


def test_a_piece_that_is_known_changes_nothing(store: EventStore) -> None:
    store.write("press-7", [piece(0, 9, end=End.UNSEEN)], 0.0)
    store.write("press-7", [piece(4, 7, end=End.UNSEEN), piece(0, 9, end=End.UNSEEN)], 0.0)

    assert spans(store) == [(0, 9, 10, "unseen")]


def test_a_piece_that_overlaps_what_is_known_extends_it(store: EventStore) -> None:
    store.write("press-7", [piece(0, 9, end=End.UNSEEN), piece(5, 14)], 0.0)

    assert spans(store) == [(0, 14, 15, "open")]


def test_after_a_lift_begins_another_contact(store: EventStore) -> None:
    store.write("press-7", [piece(0, 9), Finish("boot-0001", 9, End.LIFT, 50_000), piece(10, 12)], 0.0)

    assert spans(store) == [(0, 9, 10, "lift"), (10, 12, 3, "open")]


def test_what_went_on_when_the_service_stopped_is_unfinished_and_can_go_on(path: Path) -> None:
    first = EventStore(path, 30 * DAY_S, 1_000_000)
    first.write("press-7", [piece(0, 9)], 0.0)
    # As after a crash: the file and its log as they are while it is open.
    left = path.with_name("left.db")
    for ending in ("", "-wal"):
        shutil.copy(f"{path}{ending}", f"{left}{ending}")
    second = EventStore(left, 30 * DAY_S, 1_000_000)
    assert spans(second) == [(0, 9, 10, "unfinished")]

    second.write("press-7", [piece(10, 12), Finish("boot-0001", 12, End.LIFT, 70_000)], 0.0)
    assert spans(second) == [(0, 12, 13, "lift")]
    second.close()
    first.close()


def test_what_is_too_old_is_dropped(store: EventStore) -> None:
    store.write("press-7", [piece(0, 1)], 0.0)
    store.write("press-7", [piece(10, 11)], 20 * DAY_S)

    assert store.prune(31 * DAY_S) == 1
    assert spans(store) == [(10, 11, 2, "open")]


def test_what_is_too_much_is_dropped_the_oldest_first_and_the_file_stays_small(store: EventStore, path: Path) -> None:
    for number in range(1200):
        store.write("press-7", [piece(number * 10, number * 10 + 1, points=100)], float(number))
        if number % 100 == 99:
            store.prune(float(number))

    assert store.used_bytes() <= 1_000_000
    assert path.stat().st_size < 2_000_000
    (_, newest), *_ = store.read(Selection(limit=1))
    assert newest.first_sequence == 11_990
    kept = [one.first_sequence for _, one in store.read(Selection(limit=10_000))]
    assert kept == list(range(11_990, kept[-1] - 10, -10))


def test_a_write_that_fails_leaves_nothing_behind(store: EventStore) -> None:
    with pytest.raises(OverflowError):
        store.write("press-7", [piece(0, 9), piece(2**70, 2**70)], 0.0)

    assert spans(store) == []


def test_a_file_that_is_something_else_is_refused(tmp_path: Path, path: Path) -> None:
    (tmp_path / "text").write_text("not a database, and long enough to be sure of it\n" * 40)
    with pytest.raises(EventStoreError, match="file is not a database"):
        EventStore(tmp_path / "text", DAY_S, 1_000_000)
    with pytest.raises(EventStoreError, match="unable to open"):
        EventStore(tmp_path / "no" / "folder" / "events.db", DAY_S, 1_000_000)
    with sqlite3.connect(path) as database:
        database.execute("PRAGMA user_version = 9")
    database.close()
    with pytest.raises(EventStoreError, match="format 9"):
        EventStore(path, DAY_S, 1_000_000)
