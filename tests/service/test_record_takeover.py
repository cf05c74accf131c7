"""Services that share a record: another one goes on wherever the first one stopped, or took the same samples."""

import random
import sqlite3
from contextlib import closing
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from service.bench import Row
from service.event_story import BETWEEN, HARDER, ODD, RESTING, TOUCHING, Story
from service.postgres import at_port
from service.recording import CONTACT, Services, ends, rounded
from support.surfaces.small_model import model_of

LONG: list[Row] = [
    *([0.002, 0.0, 0.0], [0.004, 0.0, 0.0], RESTING, *[TOUCHING] * 3, *[ODD] * 5, *[HARDER] * 7),
    *(BETWEEN, RESTING, *[ODD] * 6, *[RESTING] * 4),
]


@pytest.fixture(params=["file", "PostgreSQL", "PgBouncer"])
def shared_place(request: pytest.FixtureRequest, tmp_path: Path) -> Path | str:
    if request.param == "file":
        return tmp_path / "events.db"
    url: str = request.getfixturevalue("events_url")
    if request.param == "PgBouncer":
        return at_port(url, request.getfixturevalue("pooled_port"))
    return url


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
