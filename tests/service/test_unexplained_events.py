"""Events of unexplained samples: during a contact, alone, late, and of another sender or model."""

from __future__ import annotations

import csv
import io
import random
from itertools import accumulate, pairwise
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from beamtouch_models import modelfile
from beamtouch_service.surfaces.surface import Surface
from service.event_story import BETWEEN, HARDER, ODD, RESTING, START_US, TOUCHING, Row, Story

if TYPE_CHECKING:
    from service.conftest import Bench, BuildModel, MakeBatch


def told(story: Story) -> list[tuple[str, str, str, float, float]]:
    """Kind, begin, end, dwell and unexplained part of each event."""
    return [
        (event["kind"], event["begin"], event["end"], event["dwell_ms"], event["unexplained_ms"])
        for event in story.events
    ]


def test_a_stretch_during_a_contact_counts_in_it_and_in_no_figure(bench: Bench, make_batch: MakeBatch) -> None:
    story = Story(bench, make_batch, [RESTING, *[TOUCHING] * 3, *[ODD] * 4, *[TOUCHING] * 4, RESTING])
    story.deliver(0, 5)
    assert bench.get("/contact").json()["state"] == "contact"
    story.deliver(5, 8)
    assert bench.get("/contact").json()["state"] == "unexplained"
    assert told(story)[0][:3] == ("contact", "touch", "open")
    story.deliver(8, 13)

    (event,) = story.events
    assert (event["kind"], event["begin"], event["end"], event["dwell_ms"]) == ("contact", "touch", "lift", 55.0)
    # Two odd samples come before the state, and two that are explained end it.
    assert (event["unexplained_ms"], event["samples"], len(event["path"])) == (20.0, 5, 5)
    assert (event["mean_position_mm"], event["peak_force_n"], event["quality"]) == (150.0, 8.75, "good")


def test_a_stretch_without_a_touch_is_an_event_of_its_own(bench: Bench, make_batch: MakeBatch) -> None:
    Story(bench, make_batch, [RESTING, *[ODD] * 5, *[RESTING] * 4, TOUCHING, RESTING]).deliver(0, 12)

    contact, stretch = bench.get("/events").json()["events"]
    assert (contact["kind"], contact["begin"], contact["end"]) == ("contact", "touch", "lift")
    assert (stretch["kind"], stretch["begin"], stretch["end"]) == ("unexplained", "clear", "clear")
    assert (stretch["dwell_ms"], stretch["unexplained_ms"], stretch["samples"]) == (25.0, 25.0, 0)
    assert {stretch[name] for name in ("mean_position_mm", "peak_position_mm", "peak_force_n")} == {None}
    assert bench.get(f"/events/{stretch['id']}").json()["path"] == []
    for kind, found in (("contact", contact), ("unexplained", stretch)):
        assert bench.get(f"/events?kind={kind}").json()["events"] == [found]
    assert bench.get("/events?kind=press").status_code == 422
    rows = list(csv.DictReader(io.StringIO(bench.get("/events?format=csv&kind=unexplained").text)))
    assert [(row["kind"], row["unexplained_ms"], row["mean_position_mm"]) for row in rows] == [
        ("unexplained", "25.0", "")
    ]


def test_a_contact_after_a_stretch_has_an_unseen_touch(bench: Bench, make_batch: MakeBatch) -> None:
    story = Story(bench, make_batch, [RESTING, *[ODD] * 5, *[TOUCHING] * 4, RESTING])
    story.deliver(0, 11)

    assert told(story) == [
        ("unexplained", "clear", "contact", 20.0, 20.0),
        ("contact", "unexplained", "lift", 10.0, 0.0),
    ]


def test_a_contact_that_ends_in_a_stretch_has_an_unseen_lift(bench: Bench, make_batch: MakeBatch) -> None:
    story = Story(bench, make_batch, [RESTING, *[TOUCHING] * 2, *[ODD] * 5, *[RESTING] * 3])
    story.deliver(0, 11)

    (event,) = story.events
    assert (event["begin"], event["end"], event["lifted_at"]) == ("touch", "unexplained", "2026-11-20T23:40:46.173Z")
    # From the third odd sample to the first clear one.
    assert (event["dwell_ms"], event["unexplained_ms"], event["samples"]) == (45.0, 25.0, 2)


def test_a_stretch_behind_a_gap_belongs_to_the_contact_that_late_samples_show(
    bench: Bench, make_batch: MakeBatch
) -> None:
    story = Story(bench, make_batch, [RESTING, *[TOUCHING] * 4, *[ODD] * 120, *[TOUCHING] * 6, RESTING])
    story.deliver(0, 3)
    # The gap is longer than a state is held.
    story.deliver(115, 132)
    assert [one[:3] for one in told(story)] == [
        ("contact", "touch", "unseen"),
        ("unexplained", "unseen", "contact"),
        ("contact", "unexplained", "lift"),
    ]

    story.deliver(3, 115, age_ms=60_000)
    (event,) = story.events
    assert (event["kind"], event["begin"], event["end"], event["dwell_ms"]) == ("contact", "touch", "lift", 650.0)
    # Samples 5 and 6 are odd, but not yet a stretch; samples 7 to 126 are one.
    assert (event["samples"], event["unexplained_ms"]) == (8, 600.0)


@pytest.mark.parametrize("first", [TOUCHING, RESTING])
def test_a_stretch_in_late_samples_only_is_recorded(bench: Bench, make_batch: MakeBatch, first: Row) -> None:
    story = Story(bench, make_batch, [RESTING, first, *[ODD] * 6, *[RESTING] * 5])
    story.deliver(0, 2)
    story.deliver(11, 13)
    story.deliver(2, 11, age_ms=60_000)

    (event,) = told(story)
    assert event == (
        ("contact", "touch", "unexplained", 45.0, 30.0)
        if first is TOUCHING
        else ("unexplained", "clear", "clear", 30.0, 30.0)
    )


def test_a_late_run_goes_on_from_the_stretch_beside_it(bench: Bench, make_batch: MakeBatch) -> None:
    story = Story(bench, make_batch, [RESTING, *[ODD] * 12, *[RESTING] * 4])
    story.deliver(0, 6)
    story.deliver(8, 17)
    story.deliver(6, 8, age_ms=60_000)  # too short a run to show a stretch by itself

    assert told(story) == [("unexplained", "clear", "clear", 60.0, 60.0)]


def test_a_stretch_that_another_sender_finds_begins_unseen_at_its_first_sample(
    bench: Bench, make_batch: MakeBatch
) -> None:
    story = Story(bench, make_batch, [RESTING, *[ODD] * 6, *[RESTING] * 3])
    story.deliver(0, 5)
    story.deliver(1, 10, boot_id="boot-0002")

    assert sorted(told(story)) == [
        ("unexplained", "clear", "unseen", 5.0, 5.0),
        ("unexplained", "unseen", "clear", 40.0, 40.0),
    ]


def test_undecided_samples_go_on_in_a_stretch(bench: Bench, make_batch: MakeBatch) -> None:
    story = Story(bench, make_batch, [RESTING, *[ODD] * 7, *[RESTING] * 3])
    story.deliver(0, 5)
    body = make_batch([None] * 3, sequence=5, quality=["missing"] * 3)
    body["samples"][0]["acquired_unix_us"] = START_US + 25_000
    assert bench.post(body).status_code == 200
    story.deliver(6, 11)

    assert told(story) == [("unexplained", "clear", "clear", 35.0, 35.0)]
    assert story.events[0]["quality"] == "degraded"


def test_another_model_ends_the_stretch(bench: Bench, make_batch: MakeBatch, build_model: BuildModel) -> None:
    story = Story(bench, make_batch, [RESTING, *[ODD] * 10, *[RESTING] * 3])
    story.deliver(0, 6)
    bench.app.context.registry.named("press-7").adopt(modelfile.load(build_model(name="other")))
    story.deliver(6, 14)

    assert [one[:3] for one in told(story)] == [("unexplained", "clear", "unseen"), ("unexplained", "unseen", "clear")]
    assert bench.get("/events").json()["events"][0]["samples"] == 0


_shared: dict[str, Any] = {}


@pytest.fixture(autouse=True)
def _share(make_bench: type[Bench], build_model: BuildModel, make_batch: MakeBatch) -> None:
    # Hypothesis runs a test many times with the same fixtures, and each run needs a new service.
    _shared.update(bench=make_bench, build=build_model, batch=make_batch)


@settings(max_examples=40, deadline=None)
@given(rng=st.randoms(use_true_random=True))
def test_the_order_of_delivery_does_not_change_the_record(rng: random.Random) -> None:
    kinds: list[Row] = [RESTING]
    while len(kinds) < 12:
        kinds.append(rng.choice([one for one in (TOUCHING, HARDER, RESTING, ODD, ODD) if one is not kinds[-1]]))
    lengths = [rng.randint(9, 14) for _ in kinds]
    rows = [row for row, length in zip([*kinds, RESTING], [*lengths, 9], strict=True) for _ in range(length)]
    # A change shows in the third sample after it, and fewer odd samples alone show nothing: cut only far from changes.
    cuts = [begin + rng.randint(4, length - 4) for begin, length in zip(accumulate(lengths), lengths[1:], strict=False)]
    parts = list(pairwise([0, *sorted(rng.sample(cuts, 6)), len(rows)]))
    straight = _record(rows, parts)
    rng.shuffle(parts)

    assert _record(rows, parts) == straight


def _record(rows: list[Row], parts: list[tuple[int, int]]) -> list[dict[str, Any]]:
    if "model" not in _shared:
        _shared["model"] = modelfile.load(_shared["build"]())
    # No state is held over a gap.
    surface = Surface("press-7", _shared["model"], stale_ms=4.0)
    story = Story(_shared["bench"](surface), _shared["batch"], rows)
    newest = -1
    for first, last in parts:
        story.deliver(first, last, age_ms=0.0 if last > newest else 60_000.0)
        newest = max(newest, last)
    return story.events


def begun(story: Story) -> list[tuple[str, str, str]]:
    return [one[:3] for one in told(story)]


@pytest.mark.parametrize(
    ("before", "after"),
    [
        # Neither shows by itself what came before the gap.
        (ODD, [RESTING] * 2),
        (TOUCHING, [ODD] * 2),
        (TOUCHING, [BETWEEN]),
        (TOUCHING, [BETWEEN, ODD, BETWEEN]),
    ],
    ids=["rest after a stretch", "odd after a contact", "weak after a contact", "changing after a contact"],
)
def test_the_first_samples_after_a_gap_make_no_event_by_themselves(
    bench: Bench, make_batch: MakeBatch, before: Row, after: list[Row]
) -> None:
    story = Story(bench, make_batch, [RESTING, *[before] * 5, RESTING, *after])
    story.deliver(0, 6)
    story.deliver(7, 7 + len(after))

    kind, begin = ("contact", "touch") if before is TOUCHING else ("unexplained", "clear")
    assert begun(story) == [(kind, begin, "unseen")]


@pytest.mark.parametrize("before", [RESTING, TOUCHING])
def test_odd_samples_that_come_one_by_one_before_their_neighbours_are_one_stretch(
    bench: Bench, make_batch: MakeBatch, before: Row
) -> None:
    story = Story(bench, make_batch, [RESTING, *[before] * 2, *[ODD] * 6, *[RESTING] * 4])
    story.deliver(0, 1)
    story.deliver(12, 13)
    for number in (5, 4, 7, 6, 10, 8, 3, 9, 2, 11, 1):
        story.deliver(number, number + 1, age_ms=60_000)

    (late,) = told(story)
    Story(bench, make_batch, story.rows).deliver(0, 13, boot_id="boot-0002")
    _, straight = told(story)
    assert late[:3] == straight[:3]
    assert late[3:] == pytest.approx(straight[3:], abs=10)


def test_undecided_samples_at_the_beginning_of_a_late_run_go_on_in_its_event(
    bench: Bench, make_batch: MakeBatch
) -> None:
    few: Row = [0.5, None, None]
    story = Story(bench, make_batch, [RESTING, *[ODD] * 4, *[few] * 3, *[RESTING] * 4])
    story.deliver(0, 5)
    story.deliver(8, 12)
    body = make_batch(*[few] * 3, sequence=5, quality=["good", "missing", "missing"], age_ms=60_000)
    for offset, sample in enumerate(body["samples"]):
        sample["acquired_unix_us"] = START_US + (5 + offset) * 5000
    assert bench.post(body).status_code == 200

    (event,) = told(story)
    assert event[:3] == ("unexplained", "clear", "clear")
    assert event[3] == pytest.approx(35, abs=10)


def test_rest_that_was_shown_before_the_stretch_arrived_ends_it() -> None:
    rows = [*[RESTING] * 3, *[ODD] * 6, *[RESTING] * 10]
    (event,) = _record(rows, [(10, 11), (11, 12), (6, 10), (12, 19), (0, 6)])
    assert (event["kind"], event["begin"], event["end"]) == ("unexplained", "clear", "clear")


def test_a_stretch_whose_last_sample_comes_late_goes_on_into_the_rest_after_it() -> None:
    rows = [*[RESTING] * 2, *[ODD] * 8, *[RESTING] * 8]
    straight = _record(rows, [(0, len(rows))])
    late = _record(rows, [(0, 9), (10, 18), (9, 10)])
    assert [(one["begin"], one["end"]) for one in late] == [(one["begin"], one["end"]) for one in straight]


@settings(max_examples=40, deadline=None)
@given(rng=st.randoms(use_true_random=True))
def test_wherever_parts_are_cut_their_order_moves_the_ends_of_events_by_three_samples_at_most(
    rng: random.Random,
) -> None:
    kinds: list[Row] = [RESTING]
    while len(kinds) < 8:
        kinds.append(rng.choice([one for one in (TOUCHING, RESTING, ODD, ODD) if one is not kinds[-1]]))
    rows = [row for row in [*kinds, RESTING] for _ in range(rng.randint(9, 14))]
    parts = list(pairwise([0, *sorted(rng.sample(range(1, len(rows)), 20)), len(rows)]))
    straight = _record(rows, parts)
    rng.shuffle(parts)
    shuffled = _record(rows, parts)

    names = ("kind", "begin", "end")
    assert [[one[name] for name in names] for one in shuffled] == [[one[name] for name in names] for one in straight]
    for one, other in zip(shuffled, straight, strict=True):
        assert abs(one["dwell_ms"] - other["dwell_ms"]) <= 30
        assert abs(one["samples"] - other["samples"]) <= 6
