"""The record: every sample once and in order, whatever the batches, and whatever happens to the service."""

import random
import sqlite3
from contextlib import closing
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from beamtouch_service.events import boot, record
from beamtouch_service.sections import EventsSection
from service.bench import Bench, Row, batch_of, surface_with
from service.event_story import BETWEEN, HARDER, ODD, RESTING, TOUCHING, Story
from service.postgres import at_port
from service.record_file import execute
from support.surfaces.small_model import model_of

CONTACT: list[Row] = [RESTING, *[TOUCHING] * 8, RESTING]
LONG: list[Row] = [
    *([0.002, 0.0, 0.0], [0.004, 0.0, 0.0], RESTING, *[TOUCHING] * 3, *[ODD] * 5, *[HARDER] * 7),
    *(BETWEEN, RESTING, *[ODD] * 6, *[RESTING] * 4),
]


class Services:
    """Services of one surface, each with a record of its own or with one that they share."""

    def __init__(self) -> None:
        self.model = model_of()

    def story(self, rows: list[Row], place: Path | str | None = None) -> Story:
        """Return a service that has started now, and the samples to deliver."""
        events = EventsSection(url=place) if isinstance(place, str) else EventsSection(file=place)
        return Story(Bench(surface_with(self.model), events=events), rows)

    def straight(self, rows: list[Row]) -> list[dict[str, Any]]:
        """Return the events of a service without faults."""
        story = self.story(rows)
        story.deliver(0, len(rows))
        return story.events


@pytest.fixture
def services() -> Services:
    return Services()


@pytest.fixture(params=["file", "PostgreSQL", "PgBouncer"])
def shared_place(request: pytest.FixtureRequest, tmp_path: Path) -> Path | str:
    if request.param == "file":
        return tmp_path / "events.db"
    url: str = request.getfixturevalue("events_url")
    if request.param == "PgBouncer":
        return at_port(url, request.getfixturevalue("pooled_port"))
    return url


def rounded(events: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return events with figures as near as float32 allows."""
    for event in events:
        for figures in (event, *event["path"]):
            for name in figures:
                if name.endswith(("_mm", "_n")):
                    figures[name] = figures[name] and pytest.approx(figures[name], abs=1e-3)
        event["capture"] = [one["sequence"] for one in event["capture"]]
    return events


def ends(story: Story) -> list[tuple[str, str]]:
    return [(event["begin"], event["end"]) for event in story.events]


@pytest.mark.promise("docs/reference/samples.md", "number of the next sample that the record takes")
def test_a_receipt_says_how_far_the_record_is(services: Services) -> None:
    story = services.story(CONTACT)
    receipt = story.deliver(0, 4)
    assert (receipt["durable"], receipt["expected"], receipt["stale_ms"]) == (0, 5, 500.0)
    assert ends(story) == [("touch", "open")]
    receipt = story.ask()
    assert (receipt["durable"], receipt["expected"]) == (4, 5)


@pytest.mark.promise("docs/reference/events.md", "Readers get what is durable")
def test_who_reads_the_record_gets_what_is_durable_and_makes_nothing_durable(services: Services) -> None:
    story = services.story(CONTACT)
    story.deliver(0, 10)
    for path in ("/events", "/events?path=true", "/events?format=csv"):
        assert "press-7" not in story.bench.client.get(path).text
    assert story.bench.client.get("/events/1").status_code == 404
    assert story.bench.client.get("/surfaces/press-7/calibration-data").text.count("\r\n") == 1
    assert story.ask()["durable"] == 0
    assert ends(story) == [("touch", "lift")]
    assert story.ask()["durable"] == 10


@pytest.mark.promise(
    "docs/reference/events.md",
    "an event within a second of its end, and one that is open as it was some seconds ago",
)
@pytest.mark.promise(
    "docs/reference/samples.md",
    "loses what its service had not made durable, at most a second of samples.",
)
def test_what_somebody_waits_for_is_durable_within_a_second_and_the_rest_a_little_later(
    services: Services, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(record, "LATE_S", 1e9)
    story = services.story([*CONTACT, *CONTACT])
    story.deliver(0, 1)
    story.bench.pass_second()  # of a boot that the record has yet to know
    story.deliver(1, 5)
    story.bench.pass_second()
    assert story.deliver(5, 6)["durable"] == 1
    # Asked for.
    story.ask()
    story.bench.pass_second()
    assert story.deliver(6, 7)["durable"] == 6
    # An event has ended.
    story.deliver(7, 10)
    story.bench.pass_second()
    assert story.deliver(10, 12)["durable"] == 10
    # The sender keeps nothing.
    story.oldest = None
    story.deliver(12, 13)
    story.bench.pass_second()
    assert story.deliver(13, 14)["durable"] == 13


@pytest.mark.promise("docs/reference/events.md", "The record takes each sample once and in order")
@pytest.mark.promise("docs/reference/samples.md", "The record takes each sample once and in order.")
def test_what_is_behind_a_gap_waits_for_the_backlog_and_the_answer_does_not(services: Services) -> None:
    story = services.story(CONTACT)
    story.deliver(0, 3)
    receipt = story.deliver(7, 10)
    assert receipt["expected"] == 4
    assert ends(story) == [("touch", "open")]
    before = story.bench.contact()
    assert (before["state"], before["sequence"]) == ("clear", 10)

    story.catch_up()
    assert story.bench.contact() | {"age_ms": 0} == before | {"age_ms": 0}
    assert rounded(story.events) == rounded(services.straight(CONTACT))
    assert story.ask()["durable"] == 10


def test_a_gap_within_a_batch_is_no_loss_while_the_sender_has_the_samples(services: Services) -> None:
    story = services.story(CONTACT)
    samples = batch_of(*CONTACT)["samples"]
    receipt = story.deliver(0, 0, samples=[*samples[:3], *samples[6:]])
    assert receipt["expected"] == 4
    assert ends(story) == [("touch", "open")]
    story.catch_up()
    assert rounded(story.events) == rounded(services.straight(CONTACT))
    assert 'beamtouch_record_samples_lost_total{surface="press-7"} 0.0' in story.bench.metrics()


@pytest.mark.promise(
    "docs/reference/samples.md",
    "Null in a backlog, which never moves the answer.",
    "they never touch the answer.",
)
def test_a_backlog_gives_no_answer_and_chooses_no_sender(services: Services) -> None:
    story = services.story(CONTACT)
    story.backlog(0, 10)
    assert story.bench.problem() == "no-samples"
    assert len(story.events) == 1
    other = Story(story.bench, [TOUCHING], boot_id="boot-0002")
    other.deliver(0, 1)
    assert story.bench.contact()["state"] == "contact"


def test_a_large_backlog_is_taken_whole(services: Services) -> None:
    rows = CONTACT * 60
    story = services.story(rows)
    story.backlog(0, len(rows))
    assert story.ask()["expected"] == len(rows) + 1
    assert rounded(story.events) == rounded(services.straight(rows))


@pytest.mark.promise(
    "docs/reference/events.md",
    "an event that was open there ends `unseen`",
    "`beamtouch_record_samples_lost_total` counts it",
)
@pytest.mark.promise("docs/reference/samples.md", "What is before it and not in the record is lost.")
def test_what_the_sender_lost_ends_the_event_unseen(services: Services) -> None:
    story = services.story([*CONTACT, *CONTACT])
    story.deliver(0, 3)
    story.oldest = 7
    assert story.ask()["expected"] == 7
    story.backlog(6, 20)
    assert ends(story) == [("touch", "unseen"), ("unseen", "lift"), ("touch", "lift")]
    assert 'beamtouch_record_samples_lost_total{surface="press-7"} 3.0' in story.bench.metrics()


@pytest.mark.promise("docs/reference/events.md", "An event does not change once it has ended.")
def test_an_older_request_that_comes_late_is_no_loss_and_no_repetition(services: Services) -> None:
    story = services.story(CONTACT)
    story.deliver(0, 5)
    story.oldest = 4
    story.deliver(5, 8)
    story.oldest = 1
    story.deliver(2, 7)
    story.deliver(8, 10)
    assert rounded(story.events) == rounded(services.straight(CONTACT))


def test_a_boot_that_the_record_does_not_know_begins_at_its_oldest_sample(services: Services) -> None:
    story = services.story(CONTACT)
    story.oldest = 4
    receipt = story.ask()
    assert (receipt["durable"], receipt["expected"]) == (3, 4)
    story.backlog(3, 10)
    assert ends(story) == [("unseen", "lift")]
    assert 'beamtouch_record_samples_lost_total{surface="press-7"} 0.0' in story.bench.metrics()


@pytest.mark.promise("docs/reference/samples.md", "Null: the sender keeps nothing.")
def test_of_a_sender_that_keeps_nothing_a_gap_is_a_loss(services: Services) -> None:
    story = services.story(CONTACT)
    story.oldest = None
    story.deliver(1, 3)
    story.deliver(5, 10)
    assert ends(story) == [("unseen", "unseen"), ("unseen", "lift")]


def test_a_boot_that_the_sender_no_longer_keeps_leaves_its_event_unseen(services: Services) -> None:
    story = services.story(CONTACT)
    story.deliver(0, 3)
    after = Story(story.bench, CONTACT, boot_id="boot-0002")
    after.earlier = ["boot-0001"]
    after.deliver(0, 2)
    assert sorted(ends(story)) == [("touch", "open"), ("touch", "open")]
    # A batch of the former boot that was under way does not know the new one.
    story.deliver(3, 4)
    assert sorted(ends(story)) == [("touch", "open"), ("touch", "open")]
    after.earlier = []
    after.deliver(2, 10)
    assert sorted(ends(story)) == [("touch", "lift"), ("touch", "unseen")]


def test_a_backlog_of_a_past_boot_completes_its_event(services: Services) -> None:
    story = services.story(CONTACT)
    story.deliver(0, 3)
    after = Story(story.bench, CONTACT, boot_id="boot-0002")
    after.earlier = ["boot-0001"]
    after.deliver(0, 2)
    story.earlier = ["boot-0002"]
    story.backlog(3, 10)
    assert sorted(ends(story)) == [("touch", "lift"), ("touch", "open")]


@pytest.mark.promise(
    "docs/reference/events.md",
    "ended with samples that are lost, could not be decided, or belong to another model",
)
def test_another_model_ends_the_open_event(services: Services, tmp_path: Path) -> None:
    story = services.story(CONTACT, tmp_path / "events.db")
    story.deliver(0, 5)
    assert ends(story) == [("touch", "open")]
    services.model = model_of("other")
    story = services.story(CONTACT, tmp_path / "events.db")
    assert story.ask()["expected"] == 6
    story.deliver(5, 10)
    assert ends(story) == [("touch", "unseen"), ("unseen", "lift")]


@pytest.mark.promise("docs/reference/events.md", "A surface without a model has no record.")
@pytest.mark.promise(
    "docs/reference/service-configuration.md",
    "Without it, the surface accepts samples but gives no contact.",
)
def test_without_a_model_there_is_no_record() -> None:
    surface = surface_with(None)
    story = Story(Bench(surface), CONTACT)
    assert story.deliver(0, 4)["durable"] == 4
    assert story.events == []
    # Its model file cannot be used yet: the sender keeps its samples.
    surface.model_error = "not found"
    receipt = story.offer(4, 6)
    assert (receipt["durable"], receipt["expected"]) == (None, None)


@pytest.mark.parametrize("cut", range(1, len(LONG), 4))
def test_an_event_is_the_same_wherever_another_service_goes_on(services: Services, tmp_path: Path, cut: int) -> None:
    first, second, straight = (
        services.story(LONG, tmp_path / name) for name in ("events.db", "events.db", "straight.db")
    )
    for story in (first, second, straight):
        story.is_growing = True
    first.deliver(0, cut)
    assert first.events is not None
    second.deliver(cut, len(LONG))
    straight.deliver(0, len(LONG))
    assert rounded(second.events) == rounded(straight.events)
    # The best sample of a contact stands beside the rest before it.
    data = [story.bench.get("/surfaces/press-7/calibration-data").text for story in (second, straight)]
    assert data[0] == data[1] != ""


@pytest.mark.parametrize("cut", [1, 190, 250, 800, 999])
def test_a_load_is_the_same_wherever_another_service_goes_on(services: Services, tmp_path: Path, cut: int) -> None:
    loads = [TOUCHING] * 300 + [HARDER] * 200 + [[0.5, 0.4, 0.2]] * 300 + [TOUCHING, HARDER] * 100
    rows: list[Row] = [RESTING, *loads, RESTING]
    first, second, straight = (services.story(rows, tmp_path / name) for name in ("events.db", "events.db", "other.db"))
    for story in (first, second, straight):
        story.is_growing = True
    first.deliver(0, cut)
    assert first.events is not None
    second.deliver(cut, len(rows))
    straight.deliver(0, len(rows))
    assert rounded(second.events) == rounded(straight.events)
    (event,) = second.events
    assert [point["lasts_ms"] for point in event["path"][:3]] == [1500.0, 1000.0, 1500.0]


def test_a_service_that_lost_the_race_reads_the_record_anew(services: Services, shared_place: Path | str) -> None:
    one, other = (services.story(CONTACT, shared_place) for _ in range(2))
    one.deliver(0, 3)
    assert ends(one) == [("touch", "open")]
    one.deliver(3, 5)  # not durable
    other.backlog(3, 7)
    assert ends(other) == [("touch", "open")]
    one.deliver(5, 6)
    assert ends(one) == [("touch", "open")]
    assert "beamtouch_record_races_total 1.0" in one.bench.metrics()
    one.catch_up()
    assert rounded(one.events) == rounded(other.events) == rounded(services.straight(CONTACT))


def test_another_model_during_a_commit_is_no_race(services: Services, tmp_path: Path) -> None:
    path = tmp_path / "events.db"
    story = services.story(CONTACT * 2, path)
    story.is_growing = True
    story.deliver(0, 10)
    recorder, event_loop = story.bench.app.context.recorder, story.bench.event_loop
    assert event_loop is not None
    with closing(sqlite3.connect(path, isolation_level=None)) as other:
        other.execute("BEGIN IMMEDIATE")
        commit = event_loop.start_task_soon(recorder.flush)
        story.bench.adopt(model_of("other"))
        assert story.deliver(10, 12)["durable"] == 0
        other.execute("ROLLBACK")
    commit.result()
    story.deliver(12, 20)
    assert ends(story) == [("touch", "lift"), ("touch", "lift")]
    assert "beamtouch_record_races_total 0.0" in story.bench.metrics()


KINDS: list[Row] = [TOUCHING, HARDER, RESTING, BETWEEN, ODD]
_given: dict[str, Any] = {}


@pytest.fixture
def _shared(services: Services, shared_place: Path | str) -> None:
    # Hypothesis runs a test many times with the same fixtures.
    _given.update(services=services, place=shared_place)


def deliver_some(story: Story, first: int, last: int, rng: random.Random) -> None:
    """Deliver samples live, some of the backlog, or both; make it durable, or not."""
    if rng.random() < 0.7:
        story.deliver(first, last)
    expected = story.ask()["expected"]
    if expected is not None and rng.random() < 0.7:
        story.backlog(expected - 1, min(last, expected + rng.randint(0, 20)))
    if rng.random() < 0.5:
        story.bench.get("/events")


@pytest.mark.promise("docs/reference/samples.md", "loses nothing to an outage or a killed service")
@pytest.mark.usefixtures("_shared")
@settings(max_examples=3, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
@given(rng=st.randoms(use_true_random=True))
def test_services_that_die_take_turns_and_race_record_what_one_service_would(rng: random.Random) -> None:
    services: Services = _given["services"]
    rows: list[Row] = [RESTING]
    while len(rows) < 80:
        rows += [rng.choice(KINDS)] * rng.randint(1, 9)
    rows += [RESTING] * 6
    boot_id = f"boot-{rng.getrandbits(64):016x}"

    def started() -> Story:
        story = services.story(rows, _given["place"])
        story.boot_id = boot_id
        return story

    running = [started(), started()]
    cuts = [0, *sorted(rng.sample(range(1, len(rows)), 12)), len(rows)]
    for first, last in pairwise(cuts):
        place = rng.randrange(2)
        if rng.random() < 0.2:
            running[place] = started()  # killed, and started anew
        deliver_some(running[place], first, last, rng)
    story = running[0]
    while (receipt := story.ask())["durable"] != len(rows):
        if receipt["expected"] is not None:
            story.backlog(receipt["expected"] - 1, len(rows))
        story.bench.get("/events")

    found = [event for event in story.events if event["boot_id"] == boot_id]
    expected_events = services.straight(rows)
    for event in expected_events:
        event["boot_id"] = boot_id
    assert rounded(found) == rounded(expected_events)


@pytest.mark.promise("docs/reference/http.md", "the record takes the rest when it comes again")
def test_of_a_boot_that_nothing_makes_durable_only_so_many_samples_wait(
    services: Services, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, rows = tmp_path / "events.db", CONTACT * 6
    expected = rounded(services.straight(rows))
    monkeypatch.setattr(boot, "MAX_WAITING", 20)
    story = services.story(rows, path)
    execute(path, "CREATE TRIGGER full BEFORE INSERT ON cursors BEGIN SELECT RAISE(ABORT, 'disk full'); END")
    story.deliver(0, 15)
    receipt = story.deliver(15, 60)
    assert (receipt["durable"], receipt["expected"]) == (0, 21)
    assert (story.bench.contact()["state"], story.bench.contact()["sequence"]) == ("clear", 60)
    execute(path, "DROP TRIGGER full")
    while (receipt := story.ask())["durable"] != len(rows):
        story.backlog(receipt["expected"] - 1, len(rows))
        story.bench.get("/events")
    assert rounded(story.events) == expected


@pytest.mark.parametrize("table", ["events", "cursors"])
def test_events_and_cursor_are_written_together_or_not_at_all(services: Services, tmp_path: Path, table: str) -> None:
    path = tmp_path / "events.db"
    story = services.story(CONTACT, path)
    refusal = f"CREATE TRIGGER full BEFORE INSERT ON {table} BEGIN SELECT RAISE(ABORT, 'disk full'); END"
    execute(path, refusal)
    assert story.deliver(0, 5)["expected"] == 6
    assert story.events == []
    # Neither is there, for another service either.
    other = services.story(CONTACT, path)
    assert other.events == []
    assert (other.ask()["durable"], story.ask()["durable"]) == (0, 0)

    execute(path, "DROP TRIGGER full")
    assert ends(story) == [("touch", "open")]
    assert story.ask()["durable"] == 5
    story.catch_up()
    assert rounded(story.events) == rounded(services.straight(CONTACT))


@pytest.mark.promise(
    "docs/reference/problems.md",
    "Contacts go on, and daemons keep their samples. The answer has `Retry-After`.",
)
def test_while_the_record_is_damaged_answers_go_on_and_the_cursor_stands(
    services: Services, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    story = services.story(CONTACT, tmp_path / "events.db")
    story.deliver(0, 3)
    assert len(story.events) == 1
    for one in tmp_path.glob("events.db*"):
        one.write_bytes(b"no database" * 4096)
    receipt = story.deliver(3, 10)
    assert (receipt["durable"], receipt["expected"]) == (3, 11)
    refusal = story.bench.get("/events")
    assert (refusal.status_code, refusal.headers["retry-after"]) == (503, "1")
    assert refusal.json()["type"] == "urn:beamtouch:problem:events-away"
    assert story.bench.contact()["state"] == "clear"
    assert story.ask()["durable"] == 3
    assert caplog.text.count("the record of events is away") == 1


@pytest.mark.promise("docs/reference/samples.md", "`durable` and `expected` are null while the record cannot be read.")
@pytest.mark.parametrize(
    ("damage", "reason"),
    [
        ("UPDATE cursors SET memory = substr(memory, 2)", "Extra data"),
        ("UPDATE events SET path = substr(path, 2)", "Extra data"),
        ("UPDATE events SET kind = 'bontact'", "'bontact' is not among the defined enum values"),
    ],
)
def test_a_row_that_cannot_be_read_is_said_like_any_damage(
    services: Services, tmp_path: Path, caplog: pytest.LogCaptureFixture, damage: str, reason: str
) -> None:
    path = tmp_path / "events.db"
    story = services.story(CONTACT, path)
    story.deliver(0, 3)
    assert ends(story) == [("touch", "open")]
    execute(path, damage)
    story = services.story(CONTACT, path)
    for first in range(3, 6):
        assert story.offer(first, first + 1)["durable"] is None
        assert story.bench.contact()["state"] == "contact"
    refusal = story.bench.get("/health/ready").json()
    assert refusal["missing"]["events"].startswith(f"a row cannot be read: {reason}")
    assert story.bench.get("/events?path=true").status_code in {200, 503}
    assert caplog.text.count("the record of events is away") == 1
    assert "Traceback" not in caplog.text


@pytest.mark.parametrize("is_replaced", [False, True])
def test_a_record_that_is_deleted_begins_anew_with_what_the_sender_keeps(
    services: Services, tmp_path: Path, *, is_replaced: bool
) -> None:
    path = tmp_path / "events.db"
    story = services.story(CONTACT, path)
    story.deliver(0, 3)
    assert len(story.events) == 1
    for one in tmp_path.glob("events.db*"):
        one.unlink()
    if is_replaced:
        path.touch()
    story.oldest = 4
    story.deliver(3, 5)
    story.bench.get("/events")  # the cursor is gone
    story.ask()
    story.catch_up()
    assert ends(story) == [("unseen", "lift")]
    assert story.ask()["durable"] == 10


@pytest.mark.promise(
    "docs/reference/events.md",
    "or before a pause in which the device gave none for longer than four times `stale_ms`",
)
@pytest.mark.parametrize("after_s", [1.9, 2.1])
@pytest.mark.parametrize("restarts", [False, True])
def test_a_contact_before_a_pause_of_the_device_is_not_that_after_it(
    services: Services, tmp_path: Path, *, after_s: float, restarts: bool
) -> None:
    def story() -> Story:
        return services.story([*CONTACT[:-1], *CONTACT[1:]], tmp_path / "events.db")

    before = story()
    before.deliver(0, 9)
    assert ends(before) == [("touch", "open")]
    after = story() if restarts else before
    after.later_us = round(after_s * 1e6)
    after.deliver(9, 18)
    if after_s < 2:
        assert ends(after) == [("touch", "lift")]
    else:
        assert ends(after) == [("touch", "unseen"), ("unseen", "lift")]
        assert [event["dwell_ms"] for event in after.events] == [35.0, 40.0]
