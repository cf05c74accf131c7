"""The record: every sample once and in order, whatever the batches and the boots."""

from pathlib import Path

import pytest

from beamtouch_service.record.events import surface_record
from service.bench import Bench, batch_of, surface_with
from service.event_story import TOUCHING, Story
from service.recording import CONTACT, Services, ends, rounded
from support.surfaces.small_model import model_of


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
    monkeypatch.setattr(surface_record, "LATE_S", 1e9)
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
    "and where samples belong to another model",
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


@pytest.mark.promise(
    "docs/reference/events.md",
    "before a pause in which the device gave no reading for longer than four times `stale_ms`",
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
