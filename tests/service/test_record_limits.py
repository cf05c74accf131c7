"""The limits of the record: how old and how large it becomes, whatever the wall clock says."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest

from beamtouch_service.record.writing.transactions import Transactions
from beamtouch_service.sections import EventsSection
from service.bench import Bench, Row, surface_of
from service.event_story import RESTING, TOUCHING, Story
from service.record_days import Days
from service.record_file import execute

CONTACT: list[Row] = [RESTING, *[TOUCHING] * 3, *[RESTING] * 3]
AS_THE_FIRST = """
WITH RECURSIVE boot(number) AS (SELECT 1 UNION SELECT number + 1 FROM boot WHERE number < 2000)
INSERT INTO cursors (surface, boot_id, durable, version, model, memory, event, recorded_s)
SELECT surface, 'restless-' || number, durable, version, model, memory, event, recorded_s
FROM cursors JOIN boot WHERE boot_id = 'restless-0'
"""
"""Boots whose cursors are more than a MB."""


YEARS = 3653.0


@pytest.fixture
def start(tmp_path: Path) -> Callable[[], Bench]:
    """A function that starts a service with a record of 30 days in a file, which other services may have written."""
    return lambda: Bench(surface_of(), events=EventsSection(file=tmp_path / "events.db"))


def deliver(bench: Bench, contacts: int, boot_id: str = "boot-0001") -> None:
    """Deliver contacts of one boot, and make them durable."""
    story = Story(bench, CONTACT * contacts, boot_id)
    story.deliver(0, len(story.rows))
    assert numbers(bench)  # the list is that of what is durable
    assert story.ask()["durable"] == len(story.rows)


def numbers(bench: Bench) -> list[int]:
    return [event["id"] for event in bench.get("/events?limit=1000").json()["events"]]


@pytest.mark.promise(
    "docs/reference/events.md",
    "Events are deleted after `keep_days`",
    "`beamtouch_record_events_deleted_total` counts both",
)
def test_events_leave_the_record_with_their_age(tmp_path: Path) -> None:
    bench = Bench(surface_of(), events=EventsSection(file=tmp_path / "events.db", keep_days=2))
    days = Days()
    days.run(bench)
    deliver(bench, 3)
    days.run(bench, 1.9)
    assert numbers(bench) == [3, 2, 1]
    days.run(bench, 0.2)
    assert numbers(bench) == []
    assert 'beamtouch_record_events_deleted_total{reason="age"} 3.0' in bench.metrics()


@pytest.mark.promise("docs/reference/events.md", "The age does not go by the wall clock, which may be wrong")
@pytest.mark.promise(
    "docs/reference/service-configuration.md",
    "Age at which events are deleted, by the time in which services ran.",
)
def test_a_clock_that_is_set_while_the_service_runs_makes_no_event_older(
    start: Callable[[], Bench], caplog: pytest.LogCaptureFixture
) -> None:
    bench, days = start(), Days()
    days.run(bench)
    deliver(bench, 3)
    for by in (YEARS, -YEARS, -40, 40, -YEARS, 2 * YEARS):
        days.set(by)
        days.run(bench, 2, looks=100)
        assert numbers(bench) == [3, 2, 1]
    days.run(bench, 30, looks=100)
    assert numbers(bench) == []
    warnings = [record.getMessage() for record in caplog.records if "the clock was set" in record.getMessage()]
    assert warnings[0] == "the record of events: the clock was set forward by 3653 days; events age as before"
    assert warnings[1] == "the record of events: the clock was set back by 3653 days; events age as before"
    assert len(warnings) == 6


def test_a_clock_that_is_wrong_from_the_start_on_makes_no_event_older_until_it_is_set(
    start: Callable[[], Bench], caplog: pytest.LogCaptureFixture
) -> None:
    bench, days = start(), Days()
    days.run(bench)
    deliver(bench, 3)
    days.run(bench, 26, looks=10)
    for start_number, wrong in enumerate((YEARS, -40, -YEARS)):
        bench.stop()
        bench = start()
        days.set(wrong)
        days.run(bench)
        deliver(bench, 1, f"boot-after-{start_number}")
        days.run(bench, 0.04, looks=50)  # NTP takes nearly an hour
        days.set(-wrong)
        days.run(bench, 1, looks=100)
    assert len(numbers(bench)) == 6
    said = [record.getMessage() for record in caplog.records]
    far = "the clock is 3653 days after the last entry of the record; events age by no more than 3 days of these; "
    assert f"the record of events: {far}set it if it is wrong" in said
    before = "the clock is 40 days before the last entry of the record; events do not age by it; "
    assert f"the record of events: {before}set it if it is wrong" in said


@pytest.mark.promise(
    "docs/reference/events.md",
    "and of the time in which none ran at most a tenth of `keep_days` at each start",
)
def test_a_clock_that_stays_wrong_costs_a_tenth_of_the_days_at_each_start(start: Callable[[], Bench]) -> None:
    bench, days = start(), Days()
    days.run(bench)
    days.run(bench, 2, looks=100)
    deliver(bench, 3)
    days.set(YEARS)
    for count in range(3):
        bench.stop()
        bench = start()
        days.set(YEARS)
        days.run(bench)
        days.run(bench, 1, looks=100)
        assert (count, numbers(bench)) == (count, [3, 2, 1])


def test_the_time_in_which_no_service_ran_counts(start: Callable[[], Bench]) -> None:
    """A machine that is on during the day, and off at night and at the weekend."""
    bench, days = start(), Days()
    days.run(bench)
    days.run(bench, 0.3, looks=10)
    deliver(bench, 3)
    for day in range(30):
        assert (day, numbers(bench)) == (day, [3, 2, 1])
        bench.stop()
        days.rest(2.7 if day % 7 == 4 else 0.0 if day % 7 in {5, 6} else 0.7)
        bench = start()
        days.run(bench)
        days.run(bench, 0.0 if day % 7 in {5, 6} else 0.3, looks=10)
    days.run(bench, 1, looks=10)
    assert numbers(bench) == []


def test_a_record_that_rested_for_months_is_tidied_in_its_time(start: Callable[[], Bench]) -> None:
    bench, days = start(), Days()
    days.run(bench)
    days.run(bench, 1, looks=10)
    deliver(bench, 3)
    bench.stop()
    days.rest(100)
    bench = start()
    days.run(bench)
    days.run(bench, 26, looks=100)
    assert numbers(bench) == [3, 2, 1]
    days.run(bench, 1.1, looks=10)
    assert numbers(bench) == []


def test_no_look_deletes_more_than_a_part_of_the_events_for_their_age(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    bench, days = Bench(surface_of(), events=EventsSection(file=tmp_path / "events.db")), Days()
    days.run(bench)
    deliver(bench, 250)
    assert [deleted.old for deleted in days.run(bench, 31)] == [100]
    assert len(numbers(bench)) == 150
    assert max(numbers(bench)) == 250
    assert [deleted.old for deleted in days.run(bench, looks=3)] == [100, 50, 0]
    (line,) = [record for record in caplog.records if "were older than" in record.getMessage()]
    assert (line.levelname, line.getMessage()) == (
        "WARNING",
        "100 events were deleted, as they were older than 30 days",
    )


def test_boots_without_events_take_no_room_from_events_for_longer_than_a_day(tmp_path: Path) -> None:
    bench, days = Bench(surface_of(), events=EventsSection(file=tmp_path / "events.db", max_mb=1)), Days()
    days.run(bench)
    deliver(bench, 3)
    Story(bench, [RESTING], "restless-0").deliver(0, 1)
    deliver(bench, 1, "restless-at-last")
    # Copies of the first: sending samples would take ten times as long.
    execute(tmp_path / "events.db", AS_THE_FIRST)
    database = bench.app.context.recorder.transactions.database
    with database.reading() as connection:
        assert database.used_bytes(connection) > 1e6
    days.run(bench, 1.1)
    assert sorted(numbers(bench)) == [1, 2, 3, 4]


@pytest.mark.parametrize("place", ["memory", "file", "PostgreSQL"])
def test_an_event_that_is_deleted_waits_for_no_destination(
    request: pytest.FixtureRequest, tmp_path: Path, place: str
) -> None:
    places: dict[str, Callable[[], EventsSection]] = {
        "memory": EventsSection,
        "file": lambda: EventsSection(file=tmp_path / "events.db"),
        "PostgreSQL": lambda: EventsSection(url=request.getfixturevalue("events_url")),
    }
    bench = Bench(surface_of(), events=places[place]())

    def waiting() -> int:
        assert bench.event_loop is not None
        due = partial(Transactions.due, destination="line-3", limit=0, from_start=False)
        return bench.event_loop.call(bench.app.context.recorder.write, due)[1]

    days = Days()
    days.run(bench)
    assert waiting() == 0
    deliver(bench, 3)
    assert waiting() == 3
    days.run(bench, 31, looks=100)
    assert waiting() == 0


@pytest.mark.parametrize("keeps", [True, False])
def test_a_boot_goes_on_after_a_day_without_samples(tmp_path: Path, keeps: bool) -> None:
    """Its sender may keep what is not durable, or nothing."""
    bench, days = Bench(surface_of(), events=EventsSection(file=tmp_path / "events.db")), Days()
    days.run(bench)
    story = Story(bench, [RESTING, *CONTACT])
    story.oldest = 1 if keeps else None
    story.deliver(0, 1)
    assert numbers(bench) == []
    days.run(bench, 1.1)
    story.deliver(1, len(story.rows))
    assert numbers(bench) == [1]
    assert bench.app.context.recorder.races == 0
