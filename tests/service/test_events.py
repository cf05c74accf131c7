"""Events from samples: in order, and in parts."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import pytest

from beamtouch_service.events.event import MAX_POINTS, Point, thin
from service.event_story import HARDER, RESTING, TOUCHING, Row, Story

if TYPE_CHECKING:
    from service.conftest import Bench, MakeBatch


def test_one_contact_is_one_event(bench: Bench, make_batch: MakeBatch) -> None:
    story = Story(bench, make_batch, [RESTING, TOUCHING, HARDER, TOUCHING, RESTING])
    story.deliver(0, 5)

    (event,) = bench.get("/events?path=true").json()["events"]
    assert bench.get(f"/events/{event['id']}").json() == event
    assert event.pop("model").startswith("press-7@")
    assert [point["position_mm"] for point in event.pop("path")] == [150.0, 200.0, 150.0]
    assert event.pop("capture") == []
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


def test_a_long_path_is_thinned_evenly_and_keeps_its_ends() -> None:
    path: list[Point] = [(i * 1000, float(i), None) for i in range(5000)]
    thinned = thin(path)

    assert len(thinned) <= MAX_POINTS
    assert (thinned[0], thinned[-1]) == (path[0], path[-1])
    assert max(b[0] - a[0] for a, b in pairwise(thinned)) < 60_000
