"""Which events and cursors go at a look after the limits of a record, at the bounds of age, share and size."""

import json
from collections.abc import Iterator
from contextlib import closing
from typing import Any

import pytest
from sqlalchemy import func, insert, select

from beamtouch_service.record.database.tables import CURSORS, EVENTS
from beamtouch_service.record.events.event import Begin, End, Event, EventKind
from beamtouch_service.record.trail.entry import Action
from beamtouch_service.record.trail.table import TRAIL
from beamtouch_service.record.writing.retention import Deleted, Retention
from beamtouch_service.record.writing.transactions import Transactions
from beamtouch_service.sections import EventsSection

DAY_S, NOW_S = 86_400.0, 1.8e9


class Limited:
    """A record in memory whose time is the monotonic clock, as its service has looked from 0 on."""

    def __init__(self, transactions: Transactions, keep_days: float = 1.0, max_mb: float | None = None) -> None:
        self.database = transactions.database
        self.retention = Retention(EventsSection(keep_days=keep_days, max_mb=max_mb))
        self.look(0.0)

    def look(self, uptime_s: float, *held: tuple[str, str]) -> Deleted:
        return self.retention.tidy(self.database, NOW_S + uptime_s, uptime_s, held)

    def put(self, count: int, recorded_s: float = 0.0, end: End = End.LIFT, path_bytes: int = 0) -> None:
        """Add events that were written at this time of the record."""
        kind, path = EventKind.CONTACT, ["x" * path_bytes] if path_bytes else []
        event = Event("press-7", "press-7@1", "boot-0001", 1, 1, 0, 0, kind, Begin.TOUCH, end)
        row: dict[str, Any] = vars(event) | {"recorded_s": recorded_s, "path": path}
        with self.database.writing() as connection:
            connection.execute(insert(EVENTS), [row] * count)

    def put_cursor(self, boot_id: str, surface: str = "press-7") -> None:
        row = {"surface": surface, "boot_id": boot_id, "durable": 1, "version": 1, "model": "m", "memory": {}}
        with self.database.writing() as connection:
            connection.execute(insert(CURSORS), row | {"event": None, "recorded_s": 0.0})

    @property
    def count(self) -> int:
        with self.database.reading() as connection:
            return connection.scalar(select(func.count()).select_from(EVENTS)) or 0

    @property
    def boots(self) -> list[tuple[str, str]]:
        with self.database.reading() as connection:
            rows = connection.execute(select(CURSORS.c.surface, CURSORS.c.boot_id))
            return sorted((surface, boot_id) for surface, boot_id in rows)


@pytest.fixture
def transactions() -> Iterator[Transactions]:
    with closing(Transactions(EventsSection())) as opened:
        yield opened


def test_an_event_goes_once_it_is_older_than_the_limit(transactions: Transactions) -> None:
    limited = Limited(transactions)
    limited.put(1)
    limited.put(1, recorded_s=5.0)
    found = [limited.look(DAY_S + later_s)[:2] for later_s in (0.0, 0.5, 5.0, 5.5, 6.0)]
    assert found == [(0, False), (1, False), (0, False), (1, False), (0, False)]
    assert (limited.retention.old, limited.retention.oversize, limited.count) == (2, 0, 0)


@pytest.mark.parametrize(("count", "parts"), [(250, [100, 100, 50, 0]), (2100, [105, 100, 100])])
def test_at_a_look_a_twentieth_of_the_events_goes_and_at_least_a_hundred(
    transactions: Transactions, caplog: pytest.LogCaptureFixture, count: int, parts: list[int]
) -> None:
    caplog.set_level("INFO", "beamtouch_service.record.writing")
    limited = Limited(transactions)
    limited.put(count)
    assert [limited.look(DAY_S + 1 + number).old for number in range(len(parts))] == parts
    assert limited.count == count - sum(parts)
    (record,) = caplog.records
    assert record.levelname == "WARNING"  # there are more
    assert record.getMessage() == f"{parts[0]} events were deleted, as they were older than 1 days"


def test_that_all_old_events_are_gone_is_no_warning(
    transactions: Transactions, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("INFO", "beamtouch_service.record.writing")
    limited = Limited(transactions, keep_days=1.5)
    limited.put(3)
    assert limited.look(1.5 * DAY_S + 1) == Deleted(3, are_more_old=False, oversize=0)
    (record,) = caplog.records
    assert (record.levelname, record.getMessage()) == (
        "INFO",
        "3 events were deleted, as they were older than 1.5 days",
    )


@pytest.mark.parametrize("count", [10, 60])
def test_above_its_size_a_twentieth_goes_at_a_time_and_at_least_one(
    transactions: Transactions, caplog: pytest.LogCaptureFixture, count: int
) -> None:
    """Until it is kept; an event takes 1 MB or so."""
    limited = Limited(transactions, max_mb=count - 1)
    limited.put(count, path_bytes=1_000_000)
    deleted = limited.look(1.0)
    assert (deleted.old, deleted.are_more_old) == (0, False)
    # Of 60, three at a time.
    assert (deleted.oversize, limited.retention.oversize) == ((2, 2) if count == 10 else (3, 3))
    assert limited.look(2.0).oversize == 0
    words = "events were deleted before they were 1 days old: the record is full; see events.max_mb"
    assert caplog.messages == [f"{deleted.oversize} {words}"]


def test_an_open_event_is_kept_however_large_the_record_is(transactions: Transactions) -> None:
    limited = Limited(transactions, max_mb=1)
    limited.put(2, path_bytes=1_000_000, end=End.OPEN)
    limited.put(1)
    assert [limited.look(at_s).oversize for at_s in (1.0, 2.0)] == [1, 0]
    assert limited.count == 2


@pytest.mark.parametrize(("keep_days", "after_s"), [(30.0, DAY_S), (0.5, DAY_S / 2)])
def test_the_cursor_of_a_boot_without_events_goes_after_a_day_unless_it_is_held(
    transactions: Transactions, keep_days: float, after_s: float
) -> None:
    """Or sooner, if events do."""
    limited = Limited(transactions, keep_days=keep_days)
    for boot_id in ("boot-0001", "boot-0002", "boot-held"):
        limited.put_cursor(boot_id)
    for surface in ("press-6", "press-8"):
        limited.put_cursor("boot-0001", surface)
    limited.put(1, recorded_s=after_s)  # of the first boot
    held, before = [("press-7", "boot-held"), ("press-8", "boot-0002")], limited.boots
    assert len(before) == 5
    for at_s in (after_s / 2, after_s):
        limited.look(at_s, *held)
        assert limited.boots == before
    limited.look(after_s + 1, *held)
    assert limited.boots == [("press-7", "boot-0001"), ("press-7", "boot-held")]


def told(limited: Limited) -> list[dict[str, Any]]:
    """Return what the trail says of deleted events, oldest first."""
    with limited.database.reading() as connection:
        rows = connection.execute(select(TRAIL.c.details).where(TRAIL.c.action == Action.DELETION))
        details = [json.loads(row.details) for row in rows]
    return [{name: one[name] for name in ("too_old", "beyond_max_mb")} for one in details]


@pytest.mark.promise("docs/reference/trail.md", "once a day")
def test_the_trail_tells_once_a_day_how_many_events_were_deleted_and_forgets_none(transactions: Transactions) -> None:
    limited = Limited(transactions)
    limited.put(250)
    deleted = [limited.look(DAY_S + 1).old]
    assert told(limited) == [{"too_old": 100, "beyond_max_mb": 0}]
    deleted += [limited.look(DAY_S + 61).old, limited.look(DAY_S + 121).old]
    assert len(told(limited)) == 1
    # Another service goes on with the count; and it may be killed.
    limited.retention = Retention(EventsSection(keep_days=1.0))
    limited.look(DAY_S + 181)
    limited.put(3, recorded_s=DAY_S + 181)
    for day in (2.1, 3.2, 4.3):
        deleted.append(limited.look(day * DAY_S).old)
    assert sum(deleted) == 253
    assert told(limited) == [{"too_old": number, "beyond_max_mb": 0} for number in (100, 153)]


def test_deletions_are_told_again_once_a_whole_day_of_the_record_has_passed(
    transactions: Transactions, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("INFO", "beamtouch_service.record.trail")
    limited = Limited(transactions)
    limited.put(1)
    limited.put(2, recorded_s=1.5)
    for at_s, entries in ((1.0, 1), (2.0, 1), (86_400.5, 1), (86_401.0, 2)):
        limited.look(DAY_S + at_s)
        assert len(told(limited)) == entries
    assert told(limited)[-1] == {"too_old": 2, "beyond_max_mb": 0}
    lines = [line.partition(";")[0] for line in caplog.messages if line.startswith("trail: ")]
    assert lines == [f"trail: entry {number}, deletion, by service" for number in (1, 2)]


def test_the_trail_stays_when_the_record_is_beyond_its_size(transactions: Transactions) -> None:
    limited = Limited(transactions, keep_days=30.0, max_mb=1.0)
    limited.put(60, path_bytes=40_000)
    first = limited.look(60.0).oversize
    limited.put(60, recorded_s=60.0, path_bytes=40_000)
    second = limited.look(2 * DAY_S).oversize
    assert told(limited) == [{"too_old": 0, "beyond_max_mb": number} for number in (first, second)]
