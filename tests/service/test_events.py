"""Events from samples: in order, in parts, and late."""

from __future__ import annotations

import random
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from beamtouch_models import modelfile
from beamtouch_service.events.segments import MAX_POINTS, Point, thin
from beamtouch_service.surfaces.surface import Surface
from service.event_story import HARDER, RESTING, TOUCHING, Row, Story

if TYPE_CHECKING:
    from service.conftest import Bench, BuildModel, MakeBatch


def test_one_contact_is_one_event(bench: Bench, make_batch: MakeBatch) -> None:
    story = Story(bench, make_batch, [RESTING, TOUCHING, HARDER, TOUCHING, RESTING])
    story.deliver(0, 5)

    (event,) = bench.get("/events?path=true").json()["events"]
    assert bench.get(f"/events/{event['id']}").json() == event
    assert event.pop("model").startswith("press-7@")
    assert [point["position_mm"] for point in event.pop("path")] == [150.0, 200.0, 150.0]
    assert event == {
        "id": 1,
        "surface": "press-7",
        "kind": "contact",
        "touched_at": "2026-11-20T23:40:46.128Z",
        "lifted_at": "2026-11-20T23:40:46.143Z",
        "begin": "touch",
        "end": "lift",
        "dwell_ms": 15.0,
        "unexplained_ms": 0.0,
        "peak_force_n": 12.5,
        "peak_position_mm": 200.0,
        "mean_position_mm": pytest.approx(166.6667),
        "samples": 3,
        "unsteady": False,
        "quality": "good",
        "boot_id": "boot-0001",
        "capture": False,
    }


def test_a_contact_that_goes_on_is_an_open_event(bench: Bench, make_batch: MakeBatch) -> None:
    story = Story(bench, make_batch, [RESTING, *[TOUCHING] * 500, RESTING])
    story.deliver(0, 300)
    (event,) = story.events
    assert (event["begin"], event["end"], event["lifted_at"]) == ("touch", "open", None)
    assert event["samples"] == 299

    story.deliver(300, 502)
    (event,) = story.events
    assert (event["end"], event["samples"], event["dwell_ms"]) == ("lift", 500, 2500.0)
    assert len(event["path"]) <= MAX_POINTS


def test_samples_without_all_channels_or_an_estimate_degrade_the_event(bench: Bench, make_batch: MakeBatch) -> None:
    unusable: Row = [1.0, 0.5, 0.5]
    story = Story(bench, make_batch, [RESTING, TOUCHING, unusable, TOUCHING, RESTING, RESTING, TOUCHING, RESTING])
    story.deliver(0, 8)

    assert [(event["quality"], event["samples"]) for event in story.events] == [("degraded", 2), ("good", 1)]


def test_a_new_sender_ends_the_open_event_as_unseen(bench: Bench, make_batch: MakeBatch) -> None:
    story = Story(bench, make_batch, [RESTING, TOUCHING, TOUCHING])
    story.deliver(0, 3)
    story.deliver(1, 3, boot_id="boot-0002")

    assert [(event["begin"], event["end"]) for event in story.events] == [("touch", "unseen"), ("unseen", "open")]


def test_a_gap_in_a_contact_makes_two_events_until_late_samples_fill_it(bench: Bench, make_batch: MakeBatch) -> None:
    story = Story(bench, make_batch, [RESTING, *[TOUCHING] * 8, RESTING])
    story.deliver(0, 3)
    story.deliver(7, 10)
    assert [(event["begin"], event["end"]) for event in story.events] == [("touch", "unseen"), ("unseen", "lift")]
    before = bench.get("/contact").json()

    story.deliver(3, 5, age_ms=60_000)
    story.deliver(5, 7, age_ms=50_000)
    (event,) = story.events
    assert (event["begin"], event["end"], event["samples"], event["dwell_ms"]) == ("touch", "lift", 8, 40.0)
    assert len(event["path"]) == 8
    assert bench.get("/contact").json() | {"age_ms": 0} == before | {"age_ms": 0}


def test_a_contact_in_late_samples_only_is_recorded(bench: Bench, make_batch: MakeBatch) -> None:
    story = Story(bench, make_batch, [RESTING, RESTING, TOUCHING, RESTING, RESTING, RESTING])
    story.deliver(0, 1)
    story.deliver(5, 6)
    story.deliver(1, 5, age_ms=60_000)

    assert [(event["begin"], event["end"]) for event in story.events] == [("touch", "lift")]
    assert bench.get("/contact").json()["sequence"] == 5


@settings(max_examples=40, deadline=None)
@given(rng=st.randoms(use_true_random=True))
def test_the_order_of_delivery_does_not_change_the_record(rng: random.Random) -> None:
    rows: list[Row] = [RESTING]
    while len(rows) < 60:
        rows += [rng.choice([TOUCHING, HARDER, RESTING])] * rng.randint(1, 8)
    rows.append(RESTING)
    cuts = [0, *sorted(rng.sample(range(1, len(rows)), 6)), len(rows)]
    parts = list(pairwise(cuts))
    straight = _record(rows, parts)
    rng.shuffle(parts)

    assert _record(rows, parts) == straight


_shared: dict[str, Any] = {}


@pytest.fixture(autouse=True)
def _share(make_bench: type[Bench], build_model: BuildModel, make_batch: MakeBatch) -> None:
    # Hypothesis runs a test many times with the same fixtures, and each run needs a new service.
    _shared.update(bench=make_bench, build=build_model, batch=make_batch)


def _record(rows: list[Row], parts: list[tuple[int, int]]) -> list[dict[str, Any]]:
    if "model" not in _shared:
        _shared["model"] = modelfile.load(_shared["build"]())
    bench = _shared["bench"](Surface("press-7", _shared["model"]))
    story = Story(bench, _shared["batch"], rows)
    newest = -1
    for first, last in parts:
        # Samples before the newest one are stated as old, too.
        story.deliver(first, last, age_ms=0.0 if last > newest else 60_000.0)
        newest = max(newest, last)
    return story.events


def test_a_long_path_is_thinned_evenly_and_keeps_its_ends() -> None:
    path: list[Point] = [(i * 1000, float(i), None) for i in range(5000)]
    thinned = thin(path)

    assert len(thinned) <= MAX_POINTS
    assert (thinned[0], thinned[-1]) == (path[0], path[-1])
    assert max(b[0] - a[0] for a, b in pairwise(thinned)) < 60_000
