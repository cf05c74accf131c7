"""The store of events: joining, limits, crashes, old formats and unusable files."""

from __future__ import annotations

import shutil
import sqlite3
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from beamtouch_models.modelfile import State
from beamtouch_service.events.file import EventsAwayError, EventStoreError
from beamtouch_service.events.findings import Finish
from beamtouch_service.events.segments import Begin, End, EventKind, Segment
from beamtouch_service.events.selection import Selection
from beamtouch_service.events.store import EventStore

if TYPE_CHECKING:
    from collections.abc import Iterator

DAY_S = 86_400.0


def segment(first: int, last: int, *, end: End = End.OPEN, points: int = 1) -> Segment:
    return Segment(
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
    store = EventStore(path, keep_s=30 * DAY_S, max_bytes=1_000_000)
    yield store
    store.close()


def spans(store: EventStore) -> list[tuple[int, int, int, str]]:
    found = [kept for _, kept in store.read(Selection())]
    return [(kept.first_sequence, kept.last_sequence, kept.samples, kept.end.value) for kept in reversed(found)]


def test_segments_that_meet_are_joined_in_any_order(store: EventStore) -> None:
    for part in (segment(20, 29), segment(0, 9, end=End.UNSEEN), segment(10, 19, end=End.UNSEEN)):
        store.write("press-7", [part], 0.0)

    assert spans(store) == [(0, 29, 30, "open")]


def test_a_known_segment_changes_nothing(store: EventStore) -> None:
    store.write("press-7", [segment(0, 9, end=End.UNSEEN)], 0.0)
    store.write("press-7", [segment(4, 7, end=End.UNSEEN), segment(0, 9, end=End.UNSEEN)], 0.0)

    assert spans(store) == [(0, 9, 10, "unseen")]


def test_a_segment_that_overlaps_an_event_extends_it(store: EventStore) -> None:
    store.write("press-7", [segment(0, 9, end=End.UNSEEN), segment(5, 14)], 0.0)

    assert spans(store) == [(0, 14, 15, "open")]


def test_a_segment_after_a_lift_is_another_event(store: EventStore) -> None:
    store.write("press-7", [segment(0, 9), Finish("boot-0001", 9, End.LIFT, 50_000), segment(10, 12)], 0.0)

    assert spans(store) == [(0, 9, 10, "lift"), (10, 12, 3, "open")]


def test_an_event_that_was_open_at_a_crash_is_unfinished_and_can_go_on(path: Path) -> None:
    first = EventStore(path, 30 * DAY_S, 1_000_000)
    first.write("press-7", [segment(0, 9)], 0.0)
    # The file and its log as a crash would leave them.
    left = path.with_name("left.db")
    for ending in ("", "-wal"):
        shutil.copy(f"{path}{ending}", f"{left}{ending}")
    second = EventStore(left, 30 * DAY_S, 1_000_000)
    assert spans(second) == [(0, 9, 10, "unfinished")]

    second.write("press-7", [segment(10, 12), Finish("boot-0001", 12, End.LIFT, 70_000)], 0.0)
    assert spans(second) == [(0, 12, 13, "lift")]
    second.close()
    first.close()


def test_events_that_are_too_old_are_dropped(store: EventStore) -> None:
    store.write("press-7", [segment(0, 1)], 0.0)
    store.write("press-7", [segment(10, 11)], 20 * DAY_S)

    assert store.prune(31 * DAY_S) == 1
    assert spans(store) == [(10, 11, 2, "open")]


def test_above_the_size_limit_the_oldest_events_are_dropped(store: EventStore, path: Path) -> None:
    for number in range(1200):
        store.write("press-7", [segment(number * 10, number * 10 + 1, points=100)], float(number))
        if number % 100 == 99:
            store.prune(float(number))

    assert store.used_bytes() <= 1_000_000
    assert path.stat().st_size < 2_000_000
    (_, newest), *_ = store.read(Selection(limit=1))
    assert newest.first_sequence == 11_990
    kept = [one.first_sequence for _, one in store.read(Selection(limit=10_000))]
    assert kept == list(range(11_990, kept[-1] - 10, -10))


def test_a_size_limit_below_an_empty_file_ends_the_pruning(path: Path) -> None:
    store = EventStore(path, keep_s=DAY_S, max_bytes=0)
    store.write("press-7", [segment(0, 9, end=End.LIFT)], 0.0)
    assert (store.prune(0.0), spans(store), store.prune(0.0)) == (1, [], 0)
    store.close()


def test_an_event_goes_on_from_the_state_of_its_last_sample(store: EventStore) -> None:
    stretch = replace(segment(20, 29, end=End.UNSEEN), kind=EventKind.UNEXPLAINED, ends_unexplained=True)
    lifted = segment(40, 49, end=End.LIFT)
    store.write("press-7", [segment(0, 9, end=End.UNSEEN), stretch, lifted], 0.0)
    after = [store.state_after("press-7", "boot-0001", sequence) for sequence in (9, 29, 49, 60)]
    assert after == [State.CONTACT, State.UNEXPLAINED, None, None]


def test_a_failed_write_changes_nothing(store: EventStore) -> None:
    with pytest.raises(OverflowError):
        store.write("press-7", [segment(0, 9), segment(2**70, 2**70)], 0.0)

    assert spans(store) == []


@pytest.mark.parametrize("table", ["events", "orders"])
def test_a_database_of_another_program_is_refused_unchanged(path: Path, table: str) -> None:
    with closing(sqlite3.connect(path)) as other:
        other.execute(f"CREATE TABLE {table} (name)")
    content = path.read_bytes()
    with pytest.raises(EventStoreError, match=r"it is the database of another program; set events\.file to"):
        EventStore(path, DAY_S, 1_000_000)
    assert path.read_bytes() == content


def test_an_unusable_file_is_refused_with_the_reason(tmp_path: Path, path: Path) -> None:
    (tmp_path / "text").write_text("not a database, and long enough to be sure of it\n" * 40)
    with pytest.raises(EventStoreError, match="file is not a database"):
        EventStore(tmp_path / "text", DAY_S, 1_000_000)
    late = EventStore(tmp_path / "no" / "folder" / "events.db", DAY_S, 1_000_000)
    with pytest.raises(EventsAwayError, match="unable to open"):
        late.used_bytes()
    (tmp_path / "no" / "folder").mkdir(parents=True)
    assert late.used_bytes() > 0
    late.close()
    with sqlite3.connect(path) as database:
        database.execute("PRAGMA user_version = 9")
    database.close()
    with pytest.raises(EventStoreError, match="format 9"):
        EventStore(path, DAY_S, 1_000_000)
