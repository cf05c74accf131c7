"""Events of unexplained samples: during a contact, alone, and of another model."""

from __future__ import annotations

import csv
import io
from typing import TYPE_CHECKING

import pytest

from beamtouch_models import modelfile
from beamtouch_service.surfaces.surface import Surface
from service.event_story import BETWEEN, ODD, RESTING, START_US, TOUCHING, Row, Story

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


def test_undecided_samples_go_on_in_a_stretch(bench: Bench, make_batch: MakeBatch) -> None:
    story = Story(bench, make_batch, [RESTING, *[ODD] * 7, *[RESTING] * 3])
    story.deliver(0, 5)
    body = make_batch([None] * 3, sequence=6, quality=["missing"] * 3) | {"oldest": 1}
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


def test_a_stretch_keeps_what_each_channel_of_its_first_samples_contradicts(
    make_bench: type[Bench], build_model: BuildModel, make_batch: MakeBatch
) -> None:
    wedged: Row = [0.5, 0.25, 0.75, 0.125]
    resting: Row = [0.0] * 4
    bench = make_bench(Surface("press-7", modelfile.load(build_model(channels=4))))
    story = Story(bench, make_batch, [resting, *[wedged] * 20, *[resting] * 4])
    story.deliver(0, 25)

    (event,) = story.events
    assert [sample["sequence"] for sample in event["capture"]] == [4, 5, 6, 7, 8]
    first = event["capture"][0]
    assert first["misfit"] == 500.0
    assert [channel["deflection_mm"] for channel in first["channels"]] == wedged
    assert [channel["name"] for channel in first["channels"] if channel["explained_without"]] == ["s3"]
    assert first["channels"][2]["misfit_without"] == 0.0


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
    story.oldest = 8  # the one before is lost
    story.deliver(7, 7 + len(after))

    kind, begin = ("contact", "touch") if before is TOUCHING else ("unexplained", "clear")
    assert begun(story) == [(kind, begin, "unseen")]
