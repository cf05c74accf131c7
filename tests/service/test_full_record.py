"""A record above its size: what goes is the oldest, one part at a time, and no more than is needed."""

import re
import time
from pathlib import Path

import pytest

from beamtouch_service.sections import EventsSection
from service.bench import Bench, Row, surface_of
from service.event_story import RESTING, TOUCHING, Story
from service.record_days import DAY_S, Days
from service.record_file import execute

CONTACTS = 80
CONTACT: list[Row] = [RESTING, *[TOUCHING] * 3, *[RESTING] * 3]
LARGE = "UPDATE events SET path = zeroblob(20000)"
"""The path of an hour; 80 of them are 1.6 MB."""
PART = 4
"""A twentieth of the events, which goes at a time."""


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    """A service with a record of at most 1 MB, in `events.db`, which has 80 contacts of more than that."""
    bench = Bench(surface_of(), events=EventsSection(file=tmp_path / "events.db", max_mb=1))
    Days().run(bench)
    story = Story(bench, CONTACT * CONTACTS)
    story.deliver(0, len(story.rows))
    assert numbers(bench) == list(range(1, CONTACTS + 1))
    execute(tmp_path / "events.db", LARGE)
    return bench


def numbers(bench: Bench) -> list[int]:
    """Return the numbers of all events, oldest first."""
    events = bench.get("/events?limit=1000").json()["events"]
    return [event["id"] for event in events][::-1]


def used_bytes(bench: Bench) -> int:
    database = bench.app.context.recorder.transactions.database
    with database.reading() as connection:
        return database.used_bytes(connection)


@pytest.mark.promise("docs/reference/service-configuration.md", "Beyond it, the oldest events are deleted.")
@pytest.mark.promise("docs/reference/events.md", "and the oldest above `max_mb`")
def test_above_its_size_the_oldest_events_go_and_the_newest_stay(
    bench: Bench, caplog: pytest.LogCaptureFixture
) -> None:
    assert used_bytes(bench) > 1.6e6
    (deleted,) = Days().run(bench)
    kept = numbers(bench)
    assert kept == list(range(CONTACTS - len(kept) + 1, CONTACTS + 1))
    assert (deleted.old, deleted.oversize) == (0, CONTACTS - len(kept))
    assert used_bytes(bench) <= 1e6
    assert used_bytes(bench) > 1e6 - (PART + 1) * 25_000
    assert re.search(rf'events_deleted_total{{reason="size"}} {deleted.oversize}\.0', bench.metrics())
    line = f"{deleted.oversize} events were deleted before they were 30 days old: the record is full"
    assert [one for one in caplog.messages if one.startswith(line)]
    assert Days().run(bench)[0].oversize == 0
    assert numbers(bench) == kept


def test_the_oldest_is_what_was_written_first_whatever_its_number(bench: Bench, tmp_path: Path) -> None:
    """A long contact is numbered when it begins, and is written last when it ends."""
    execute(tmp_path / "events.db", "UPDATE events SET recorded_s = recorded_s + 60 WHERE id = 1")
    Days().run(bench)
    oldest, *others = numbers(bench)
    assert (oldest, others) == (1, list(range(CONTACTS - len(others) + 1, CONTACTS + 1)))


def test_an_event_that_is_open_does_not_go(tmp_path: Path) -> None:
    bench = Bench(surface_of(), events=EventsSection(file=tmp_path / "events.db", max_mb=1))
    Days().run(bench)
    open_story = Story(bench, [RESTING, *[TOUCHING] * 3], "boot-open")
    open_story.deliver(0, len(open_story.rows))
    assert numbers(bench) == [1]
    story = Story(bench, CONTACT * CONTACTS)
    story.earlier = ["boot-open"]
    story.deliver(0, len(story.rows))
    assert len(numbers(bench)) == CONTACTS + 1
    execute(tmp_path / "events.db", LARGE)
    Days().run(bench)
    kept = numbers(bench)
    assert len(kept) < CONTACTS
    assert kept[0] == 1
    assert bench.get("/events?limit=1000").json()["events"][-1]["end"] == "open"


def test_a_record_in_postgresql_is_as_large_as_its_rows(events_url: str) -> None:
    bench = Bench(surface_of(), events=EventsSection(url=events_url))
    assert used_bytes(bench) == 0
    story = Story(bench, CONTACT * 6)
    sizes = list[int]()
    for part in range(2):
        story.deliver(3 * len(CONTACT) * part, 3 * len(CONTACT) * (part + 1))
        assert numbers(bench) == list(range(1, 3 * part + 4))
        sizes.append(used_bytes(bench))
    assert 3 * 100 < sizes[0] < 3 * 2000
    assert sizes[1] == pytest.approx(2 * sizes[0], rel=0.2)


@pytest.mark.parametrize(
    ("days", "said"),
    [(3.0, ["3 days ahead of"]), (-3.0, ["3 days behind"]), (0.0, [])],
    ids=["ahead", "behind", "alike"],
)
def test_a_clock_other_than_that_of_the_database_is_told_once(
    events_url: str, caplog: pytest.LogCaptureFixture, days: float, said: list[str]
) -> None:
    bench, clocks = Bench(surface_of(), events=EventsSection(url=events_url)), Days()
    clocks.clock_s = time.time() + days * DAY_S
    clocks.run(bench, looks=2)
    told = [one for one in caplog.messages if one.startswith("the clock of this machine")]
    line = "the clock of this machine is {} that of the database; the record goes by the latter"
    assert told == [line.format(one) for one in said]
