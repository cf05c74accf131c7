"""Captures of unexplained stretches: what they say of each channel, how large they get, and when they go."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import pytest

from beamtouch_models import modelfile
from beamtouch_service.events.captures import MAX_SAMPLES, Capture
from beamtouch_service.events.segments import Begin, End, EventKind, Segment
from beamtouch_service.events.selection import Selection
from beamtouch_service.events.store import EventStore
from beamtouch_service.surfaces.contradiction import Contradiction
from beamtouch_service.surfaces.stretch_samples import WHOLE, is_kept
from beamtouch_service.surfaces.surface import Surface
from service.event_story import ODD, RESTING, TOUCHING, Row, Story

if TYPE_CHECKING:
    from pathlib import Path

    from service.conftest import Bench, BuildModel, MakeBatch

DAY_S = 86_400.0
WEDGED: Row = [0.5, 0.25, 0.75, 0.125]
"""Without s3, a contact."""


@pytest.fixture
def four(make_bench: type[Bench], build_model: BuildModel) -> Bench:
    return make_bench(Surface("press-7", modelfile.load(build_model(channels=4))))


def test_a_capture_shows_the_channel_without_which_everything_is_explained(four: Bench, make_batch: MakeBatch) -> None:
    resting: Row = [0.0] * 4
    Story(four, make_batch, [resting, *[WEDGED] * 60, *[resting] * 3]).deliver(0, 64)
    (event,) = four.get("/events").json()["events"]
    capture = four.get(f"/events/{event['id']}/capture").json()

    assert (capture["id"], capture["surface"], capture["model"]) == (event["id"], "press-7", event["model"])
    # 58 odd samples, and two that are explained again.
    assert [sample["sequence"] for sample in capture["samples"]] == list(range(3, 63))
    assert capture["explained_without"] == {"s1": 2, "s2": 2, "s3": 60, "s4": 2}
    sample = capture["samples"][45]
    assert sample["sampled_at"] == "2026-11-20T23:40:46.363Z"
    assert sample["notes"] == ["check-s3"]
    assert (sample["misfit"], sample["misfit_limit"], sample["rest_limit"]) == (500.0, 30.0, 30.0)
    assert sample["rest_misfit"] == pytest.approx(
        sum(channel["rest_residual"] ** 2 for channel in sample["channels"]), rel=1e-4
    )
    third = sample["channels"][2]
    assert (third["name"], third["deflection_mm"], third["standard_error_mm"]) == ("s3", 0.75, 0.01)
    # Its floor is 0.3 % of the deflection, and 2 um.
    assert third["rest_residual"] == pytest.approx(0.75 / (0.01**2 + 0.00225**2 + 0.002**2) ** 0.5, rel=1e-4)
    assert (third["misfit_without"], third["explained_without"]) == (0.0, True)
    assert (sample["channels"][1]["misfit_without"], sample["channels"][1]["explained_without"]) == (750.0, False)


def test_where_two_channels_would_be_left_none_is_left_out(bench: Bench, make_batch: MakeBatch) -> None:
    Story(bench, make_batch, [RESTING, TOUCHING, *[ODD] * 5]).deliver(0, 7)
    capture = bench.get("/events/1/capture").json()

    # Three channels allow one contradiction, two allow none.
    assert [sample["sequence"] for sample in capture["samples"]] == [4, 5, 6]
    channels = capture["samples"][0]["channels"]
    assert [(one["name"], one["misfit_without"], one["explained_without"]) for one in channels] == [
        (f"s{number}", None, False) for number in (1, 2, 3)
    ]


def test_an_event_without_a_stretch_has_an_empty_capture_and_an_unknown_one_none(
    bench: Bench, make_batch: MakeBatch
) -> None:
    Story(bench, make_batch, [RESTING, TOUCHING, RESTING]).deliver(0, 3)
    found = bench.get("/events/1/capture").json()
    assert (found["samples"], found["explained_without"]) == ([], {})

    missing = bench.get("/events/2/capture")
    assert (missing.status_code, missing.json()["type"]) == (404, "urn:beamtouch:problem:unknown-event")
    assert bench.get("/events/x/capture").status_code == 422


def test_of_a_long_stretch_fewer_and_fewer_samples_are_kept() -> None:
    kept = [number for number in range(100 * WHOLE) if is_kept(number)]

    assert kept[:WHOLE] == list(range(WHOLE))
    assert [sum(WHOLE << n <= one < WHOLE << n + 1 for one in kept) for n in range(6)] == [25] * 6
    day = 86_400 * 200 * 3 // 4
    assert WHOLE + 25 * (day // WHOLE).bit_length() <= MAX_SAMPLES


def test_each_stretch_of_a_contact_is_captured_and_an_hour_of_them_is_bounded(
    bench: Bench, make_batch: MakeBatch
) -> None:
    once = [*[TOUCHING] * 3, *[ODD] * 5, *[TOUCHING] * 3]
    story = Story(bench, make_batch, [RESTING, *once * 200, RESTING])
    for first in range(0, len(story.rows), 1000):
        story.deliver(first, min(first + 1000, len(story.rows)))
    (event,) = story.events
    assert (event["kind"], event["end"]) == ("contact", "lift")

    response = bench.get("/events/1/capture")
    sequences = [sample["sequence"] for sample in response.json()["samples"]]
    # Of each stretch, three odd samples and two explained ones: up to the room of an event.
    assert sequences[:10] == [6, 7, 8, 9, 10, 17, 18, 19, 20, 21]
    assert len(sequences) == MAX_SAMPLES
    assert len(response.content) < 1_000_000


def stretch(first: int, last: int, **values: object) -> Segment:
    times = first * 5000, last * 5000
    known = {"kind": EventKind.UNEXPLAINED, "end": End.UNSEEN, "ends_unexplained": True, **values}
    return Segment("press-7", "tiny@000000", "boot-0001", first, last, *times, **known)  # type: ignore[arg-type]


def capture(first: int, last: int) -> Capture:
    samples = [
        Contradiction(
            sequence=number,
            sampled_at="1970-01-01T00:00:00.000Z",
            readings=1,
            misfit=100.0,
            misfit_limit=30.0,
            rest_misfit=100.0,
            rest_limit=30.0,
            log_odds=10.0,
            notes=[],
            channels=[],
        )
        for number in range(first, last + 1)
    ]
    return Capture("tiny@000000", "boot-0001", samples)


def test_captures_stay_with_events_that_are_joined_and_go_with_those_that_are_dropped(tmp_path: Path) -> None:
    store = EventStore(tmp_path / "events.db", keep_s=30 * DAY_S, max_bytes=1_000_000)
    store.write("press-7", [stretch(10, 14), capture(10, 14)], 0.0)
    store.write("press-7", [stretch(20, 24), capture(20, 24)], 0.0)
    store.write("press-7", [stretch(15, 19), capture(15, 19)], 0.0)
    store.write("press-7", [stretch(40, 44, begin=Begin.CLEAR), capture(40, 44)], 20 * DAY_S)
    # The sender repeats samples after a restart of the service.
    store.write("press-7", [stretch(23, 26), capture(23, 26)], 0.0)

    (newest, young), (oldest, old) = store.read(Selection(kind=EventKind.UNEXPLAINED))
    assert [one.sequence for one in store.capture(old)] == list(range(10, 27))
    assert store.prune(31 * DAY_S) == 1
    assert store.get(oldest) is None
    assert store.capture(old) == []
    assert [one.sequence for one in store.capture(young)] == list(range(40, 45))
    assert newest != oldest
    store.close()


def test_above_the_size_limit_the_oldest_captures_go_and_the_events_stay(tmp_path: Path) -> None:
    store = EventStore(tmp_path / "events.db", keep_s=30 * DAY_S, max_bytes=1_000_000)
    contacts = [stretch(n * 10, n * 10 + 5, kind=EventKind.CONTACT, ends_unexplained=False) for n in range(100)]
    store.write("press-7", contacts, 0.0)
    for number in range(60):
        first = (number + 1) * 1000
        store.write("press-7", [stretch(first, first + 299), capture(first, first + 299)], float(number))
        store.prune(float(number))

    assert store.used_bytes() <= 1_000_000
    assert len(store.read(Selection(limit=1000, kind=EventKind.CONTACT))) == 100
    kept = store.read(Selection(limit=1000, kind=EventKind.UNEXPLAINED))
    lengths = [len(store.capture(event)) for _, event in kept]
    assert lengths == sorted(lengths, reverse=True)
    assert len(lengths) == 60
    assert set(lengths) == {0, 300}
    store.close()


def test_captures_survive_the_service_and_other_programs_can_read_them(tmp_path: Path) -> None:
    store = EventStore(tmp_path / "events.db", keep_s=DAY_S, max_bytes=1_000_000)
    store.write("press-7", [stretch(10, 14), capture(10, 14)], 0.0)
    store.close()

    store = EventStore(tmp_path / "events.db", keep_s=DAY_S, max_bytes=1_000_000)
    ((_, event),) = store.read(Selection())
    (first, *_) = store.capture(event)
    assert first == capture(10, 10).samples[0]
    with store._place._engine.connect() as connection:
        text = connection.exec_driver_sql("SELECT sample FROM captures").scalar()
    assert json.loads(str(text))["misfit"] == 100.0
    store.close()
