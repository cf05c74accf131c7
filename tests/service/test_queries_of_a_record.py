"""What a page of the record holds: its bounds, its order, and the axes of its table."""

from collections import namedtuple
from collections.abc import Iterator
from contextlib import closing
from datetime import UTC, datetime, timedelta, timezone
from typing import Any, cast

import pytest
from sqlalchemy import insert

from beamtouch_service.api.times import microseconds
from beamtouch_service.record import Begin, End, Event, EventKind
from beamtouch_service.record.database.errors import UnreadableRowError
from beamtouch_service.record.database.tables import EVENTS
from beamtouch_service.record.database.values import Unreadable
from beamtouch_service.record.reading.queries import find_axes, find_best_samples, find_events, read_events
from beamtouch_service.record.reading.readers import Reader
from beamtouch_service.record.writing.transactions import Transactions
from beamtouch_service.sections import EventsSection

NOW_S = 5000.0
AHEAD_US = 5_000_000_000 + 86_400_000_000
"""A day after now: what is later is of a clock ahead."""
Key = namedtuple("Key", ("touched_us", "id"))


class Kept:
    """A record with events of these touches, numbered from 1 on."""

    def __init__(self, transactions: Transactions) -> None:
        self._database = transactions.database
        self.reader = Reader(self._database)

    def put(
        self, *touched_us: int, surface: str = "a", kind: EventKind = EventKind.CONTACT, best: object = None
    ) -> None:
        for at_us in touched_us:
            event = Event(surface, "m@1", "boot-0001", 1, 1, at_us, at_us, kind, Begin.TOUCH, End.LIFT)
            with self._database.writing() as connection:
                connection.execute(insert(EVENTS).values(vars(event) | {"recorded_s": 0.0, "best": best}))

    def find(self, **asked: Any) -> list[int]:  # noqa: ANN401  # as `find_events`
        return [key.id for key in find_events(self.reader, **asked)]


@pytest.fixture
def kept(monkeypatch: pytest.MonkeyPatch) -> Iterator[Kept]:
    monkeypatch.setattr("beamtouch_service.record.reading.queries.time.time", lambda: NOW_S)
    with closing(Transactions(EventsSection())) as transactions:
        yield Kept(transactions)


def test_a_span_begins_with_since_and_ends_before_until(kept: Kept) -> None:
    kept.put(100, 200, 300)
    assert kept.find() == [3, 2, 1]
    assert kept.find(since_us=200) == [3, 2]
    assert kept.find(since_us=201) == [3]
    assert kept.find(until_us=300) == [2, 1]
    assert kept.find(until_us=301) == [3, 2, 1]
    assert kept.find(since_us=100, until_us=200) == [1]


def test_events_are_found_by_surface_and_kind(kept: Kept) -> None:
    kept.put(100, 200)
    kept.put(150, surface="b", kind=EventKind.UNEXPLAINED)
    assert (kept.find(surface="a"), kept.find(surface="b")) == ([2, 1], [3])
    assert (kept.find(kind=EventKind.UNEXPLAINED), kept.find(kind=EventKind.CONTACT)) == ([3], [2, 1])
    assert kept.find(surface="a", kind=EventKind.UNEXPLAINED) == []


def test_a_page_goes_on_after_the_last_event_of_the_one_before(kept: Kept) -> None:
    kept.put(300, 200, 200, 200, 100)
    assert kept.find(limit=2) == [1, 4]
    assert kept.find(after=(200, 4), limit=2) == [3, 2]
    assert kept.find(after=(200, 2)) == [5]
    assert kept.find(after=(100, 5)) == []


def test_events_of_a_clock_more_than_a_day_ahead_come_last(kept: Kept) -> None:
    kept.put(AHEAD_US + 1, AHEAD_US, 100, AHEAD_US + 7)
    assert kept.find() == [2, 3, 4, 1]
    assert kept.find(limit=3) == [2, 3, 4]
    assert kept.find(after=(100, 3)) == [4, 1]
    assert kept.find(after=(AHEAD_US, 2), limit=2) == [3, 4]
    assert kept.find(after=(AHEAD_US + 7, 4)) == [1]
    assert kept.find(after=(AHEAD_US + 1, 1)) == []


def test_a_hundred_events_are_found_unless_another_limit_is_asked_for(kept: Kept) -> None:
    kept.put(*range(101))
    assert len(kept.find()) == 100
    assert len(kept.find(limit=101)) == 101


@pytest.mark.parametrize(("path", "parts"), [(False, [100, 3]), (True, [25, 25, 25, 25, 3])])
def test_events_are_read_some_at_a_time_without_those_that_went_meanwhile(
    kept: Kept, path: bool, parts: list[int]
) -> None:
    kept.put(*range(103))
    keys = find_events(kept.reader, limit=103)
    found = [[one.number for one in events] for events in read_events(kept.reader, keys, path=path)]
    assert [len(part) for part in found] == parts
    assert [number for part in found for number in part] == list(range(103, 0, -1))
    gone = cast("Any", Key(0, 999))
    ((first, second),) = read_events(kept.reader, [keys[5], gone, keys[2]], path=path)
    assert (first.number, second.number) == (98, 101)


def test_best_samples_are_those_of_contacts_oldest_first(kept: Kept) -> None:
    kept.put(300, best={"is_contact": True})
    kept.put(200, best={"is_contact": False})
    kept.put(250)
    kept.put(100, 400, best={"is_contact": True})
    kept.put(350, surface="b", best={"is_contact": True})

    def find(since_us: int | None = None, until_us: int | None = None, limit: int = 9) -> list[int]:
        return [key.id for key in find_best_samples(kept.reader, "a", since_us, until_us, limit)]

    assert find() == [4, 1, 5]
    assert find(limit=2) == [1, 5]
    assert (find(since_us=300), find(until_us=300)) == ([1, 5], [4])


Placed = namedtuple("Placed", ("id", "surface", "place"))


class Rows:
    """A reader that has these rows, and counts its rests."""

    def __init__(self, *places: object) -> None:
        self._places, self.rests = places, 0

    def rows(self, _statement: object, ids: list[int]) -> list[Placed]:
        return [Placed(number, "press-7", place) for number, place in zip(ids, self._places, strict=True)]

    def rest(self) -> None:
        self.rests += 1


def axes_of(rows: Rows, *ids: int) -> list[tuple[str, ...]]:
    return find_axes(cast("Any", rows), cast("Any", [Key(0, number) for number in ids]))


def test_a_table_has_the_axes_of_all_its_events_and_its_reader_rests_after_each() -> None:
    rows = Rows({"x": None, "y": None}, {"position": None}, {"x": None, "y": None})
    assert axes_of(rows, 7, 8, 9) == [("x", "y"), ("position",)]
    assert rows.rests == 3
    assert axes_of(Rows()) == [("position",)]


def test_an_event_whose_place_is_damaged_ends_its_table() -> None:
    with pytest.raises(UnreadableRowError, match=r"^event 7 of surface press-7 cannot be read: .* column place: torn$"):
        axes_of(Rows(Unreadable("torn")), 7)


def test_a_time_of_a_request_is_exact_to_the_microsecond() -> None:
    assert microseconds(None) is None
    assert microseconds(datetime(2026, 11, 20, 23, 40, 46, 123_457, UTC)) == 1_795_218_046_123_457
    assert microseconds(datetime(1970, 1, 1, 1, 0, 0, 3, timezone(timedelta(hours=2)))) == -3_599_999_997
