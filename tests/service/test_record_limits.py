"""The limits of the record: how old and how large it becomes."""

import time
from functools import partial
from pathlib import Path

import pytest

from beamtouch_service.sections import EventsSection
from service.bench import Bench, Row, surface_of
from service.event_story import RESTING, TOUCHING, Story
from service.record_file import execute

CONTACT: list[Row] = [RESTING, *[TOUCHING] * 3, *[RESTING] * 3]
DAY_S = 86_400.0
AS_THE_FIRST = """
WITH RECURSIVE boot(number) AS (SELECT 1 UNION SELECT number + 1 FROM boot WHERE number < 2000)
INSERT INTO cursors (surface, boot_id, durable, version, model, memory, event, recorded_s)
SELECT surface, 'restless-' || number, durable, version, model, memory, event, recorded_s
FROM cursors JOIN boot WHERE boot_id = 'restless-0'
"""
"""Boots whose cursors are more than a MB."""


def prune(bench: Bench, days: float) -> int:
    """Have the record look at its limits so many days from now; return how many events it deletes."""
    prune_at = partial(bench.app.context.recorder.prune, time.time() + days * DAY_S)
    assert bench.event_loop is not None
    return bench.event_loop.call(prune_at)


def deliver(bench: Bench, contacts: int, boot_id: str = "boot-0001") -> None:
    """Deliver contacts of one boot, and make them durable."""
    story = Story(bench, CONTACT * contacts, boot_id)
    story.deliver(0, len(story.rows))
    assert numbers(bench)  # the list is that of what is durable
    assert story.ask()["durable"] == len(story.rows)


def numbers(bench: Bench) -> list[int]:
    return [event["id"] for event in bench.get("/events?limit=1000").json()["events"]]


def test_events_leave_the_record_with_their_age(tmp_path: Path) -> None:
    bench = Bench(surface_of(), events=EventsSection(file=tmp_path / "events.db", keep_days=2))
    deliver(bench, 3)
    assert prune(bench, 1.9) == 0
    assert numbers(bench) == [3, 2, 1]
    assert prune(bench, 2.1) == 3
    assert numbers(bench) == []


def test_boots_without_events_take_no_room_from_events_for_longer_than_a_day(tmp_path: Path) -> None:
    bench = Bench(surface_of(), events=EventsSection(file=tmp_path / "events.db", max_mb=1))
    deliver(bench, 3)
    Story(bench, [RESTING], "restless-0").deliver(0, 1)
    deliver(bench, 1, "restless-at-last")
    # Copies of the first: sending samples would take ten times as long.
    execute(tmp_path / "events.db", AS_THE_FIRST)
    database = bench.app.context.recorder.store.database
    with database.reading() as connection:
        assert database.used_bytes(connection) > 1e6
    assert prune(bench, 1.1) == 0
    assert sorted(numbers(bench)) == [1, 2, 3, 4]


@pytest.mark.parametrize("keeps", [True, False])
def test_a_boot_goes_on_after_a_day_without_samples(tmp_path: Path, keeps: bool) -> None:
    """Its sender may keep what is not durable, or nothing."""
    bench = Bench(surface_of(), events=EventsSection(file=tmp_path / "events.db"))
    story = Story(bench, [RESTING, *CONTACT])
    story.oldest = 1 if keeps else None
    story.deliver(0, 1)
    assert numbers(bench) == []
    prune(bench, 1.1)
    story.deliver(1, len(story.rows))
    assert numbers(bench) == [1]
    assert bench.app.context.recorder.races == 0
