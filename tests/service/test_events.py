"""Which samples make an event, and what it says."""

import pytest

from service.bench import START_US, Bench, Row, surface_of
from service.event_story import BETWEEN, HARDER, ODD, RESTING, TOUCHING, Story, story_of


def test_one_contact_is_one_event(bench: Bench) -> None:
    Story(bench, [RESTING, TOUCHING, HARDER, TOUCHING, RESTING]).deliver(0, 5)
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
        "mean_position_mm": pytest.approx(166.6667),
        "mean_position_low_mm": pytest.approx(165.6667),
        "mean_position_high_mm": pytest.approx(167.6667),
        "min_position_mm": 150.0,
        "max_position_mm": 200.0,
        "mean_force_n": 10.0,
        "mean_force_low_n": 9.0,
        "mean_force_high_n": 11.0,
        "peak_force_n": 12.5,
        "peak_force_low_n": 11.5,
        "peak_force_high_n": 13.5,
        "peak_position_mm": 200.0,
        "samples": 3,
        "unsteady_samples": 0,
        "unsteady": False,
        "quality": "good",
        "boot_id": "boot-0001",
    }


def test_a_contact_that_goes_on_is_an_open_event_and_its_path_says_what_changed(bench: Bench) -> None:
    story = Story(bench, [RESTING, *[TOUCHING] * 600, *[HARDER] * 400, RESTING])
    story.deliver(0, 300)
    (event,) = story.events
    assert (event["begin"], event["end"], event["lifted_at"], event["samples"]) == ("touch", "open", None, 299)
    assert [point["lasts_ms"] for point in event["path"]] == [1490.0]
    story.deliver(300, 1002)
    (event,) = story.events
    assert (event["end"], event["samples"], event["dwell_ms"]) == ("lift", 1000, 5000.0)
    first, second = event["path"]
    assert first == {
        "at": "2026-11-20T23:40:46.128Z",
        "lasts_ms": 3000.0,
        "position_mm": 150.0,
        "position_low_mm": 149.0,
        "position_high_mm": 151.0,
        "force_n": 8.75,
        "force_low_n": 7.75,
        "force_high_n": 9.75,
        "unsteady": False,
    }
    assert (second["at"], second["lasts_ms"]) == ("2026-11-20T23:40:49.128Z", 2000.0)
    assert (second["position_mm"], second["force_n"]) == (200.0, 12.5)
    assert (event["mean_position_mm"], event["mean_force_n"]) == (pytest.approx(170.0), pytest.approx(10.25))


@pytest.mark.promise("docs/reference/events.md", "Beyond 25 stays, the two neighbours that lasted least become one")
def test_a_path_of_many_changes_stays_short_and_keeps_the_mean(bench: Bench) -> None:
    story = Story(bench, [RESTING, HARDER, *[TOUCHING, HARDER] * 200, RESTING])
    story.deliver(0, 403)
    (event,) = story.events
    assert len(event["path"]) <= 25  # points of a path, `docs/reference/events.md`
    assert sum(point["lasts_ms"] for point in event["path"]) == event["dwell_ms"] == 2005.0
    assert event["mean_force_n"] == pytest.approx((201 * 12.5 + 200 * 8.75) / 401, abs=1e-4)
    assert event["mean_position_mm"] == pytest.approx((201 * 200.0 + 200 * 150.0) / 401, abs=1e-4)


def test_samples_without_all_channels_or_an_estimate_degrade_the_event(bench: Bench) -> None:
    unusable: Row = [1.0, 0.5, 0.5]
    story = Story(bench, [RESTING, TOUCHING, unusable, TOUCHING, RESTING, RESTING, TOUCHING, RESTING])
    story.deliver(0, 8)
    assert [(event["quality"], event["samples"]) for event in story.events] == [("degraded", 2), ("good", 1)]


def told(story: Story) -> list[tuple[str, str, str, float, float]]:
    """Kind, begin, end, dwell and unexplained part of each event."""
    return [
        (event["kind"], event["begin"], event["end"], event["dwell_ms"], event["unexplained_ms"])
        for event in story.events
    ]


@pytest.mark.promise(
    "docs/reference/events.md",
    "The stretch counts in `unexplained_ms`, and in no force, position or path.",
    "a contact after an unexplained stretch, so its touch was not seen",
    "An unexplained event has no force, no position and an empty path.",
    "A contact outlasts an unexplained stretch.",
)
@pytest.mark.parametrize(
    ("rows", "events"),
    [
        # Two odd samples come before the state, and two that are explained end it.
        ([*[TOUCHING] * 3, *[ODD] * 4, *[TOUCHING] * 4, RESTING], [("contact", "touch", "lift", 55.0, 20.0)]),
        ([*[ODD] * 5, *[RESTING] * 4], [("unexplained", "clear", "clear", 25.0, 25.0)]),
        # A contact that begins in a stretch has an unseen touch, and one that ends in a stretch an unseen lift.
        (
            [*[ODD] * 5, *[TOUCHING] * 4, RESTING],
            [("unexplained", "clear", "contact", 20.0, 20.0), ("contact", "unexplained", "lift", 10.0, 0.0)],
        ),
        ([*[TOUCHING] * 2, *[ODD] * 5, *[RESTING] * 3], [("contact", "touch", "unexplained", 45.0, 25.0)]),
    ],
    ids=["during", "alone", "before", "after"],
)
def test_an_unexplained_stretch_counts_in_a_contact_or_is_an_event_of_its_own(
    bench: Bench, rows: list[Row], events: list[tuple[str, str, str, float, float]]
) -> None:
    story = story_of(bench, [RESTING, *rows])
    assert told(story) == events
    for event in story.events:
        is_contact = event["kind"] == "contact"
        figures = [event[name] for name in ("mean_position_mm", "peak_position_mm", "peak_force_n")]
        assert figures == ([150.0, 150.0, 8.75] if is_contact else [None] * 3)
        assert (event["samples"] > 0) is is_contact


@pytest.mark.promise(
    "docs/reference/events.md",
    "Samples that contradict the contact, but are too few for a stretch, count in no figure.",
)
def test_samples_that_contradict_a_contact_and_are_no_stretch_count_in_no_figure(bench: Bench) -> None:
    rows: list[Row] = [*[TOUCHING] * 3, *[ODD] * 2, *[TOUCHING] * 3]
    story = story_of(bench, [RESTING, *rows, RESTING])
    assert told(story) == [("contact", "touch", "lift", 40.0, 0.0)]
    (event,) = story.events
    assert (event["samples"], event["unsteady_samples"]) == (6, 0)
    assert [event[f"{name}_position_mm"] for name in ("min", "mean", "max", "peak")] == [150.0] * 4


def test_undecided_samples_go_on_in_a_stretch(bench: Bench) -> None:
    story = Story(bench, [RESTING, *[ODD] * 7, *[RESTING] * 3])
    story.deliver(0, 5)
    missing: Row = [None] * 3
    bench.send(missing, sequence=6, quality=["missing"] * 3, begin_us=START_US + 25_000, members={"oldest": 1})
    story.deliver(6, 11)
    assert told(story) == [("unexplained", "clear", "clear", 35.0, 35.0)]
    assert story.events[0]["quality"] == "degraded"


@pytest.mark.promise("docs/reference/events.md", "holds the first five unexplained samples of an event")
def test_a_stretch_keeps_what_each_channel_of_its_first_samples_contradicts() -> None:
    wedged: Row = [0.5, 0.25, 0.75, 0.125]
    resting: Row = [0.0] * 4
    (event,) = story_of(Bench(surface_of(channels=4)), [resting, *[wedged] * 20, *[resting] * 4]).events
    assert [sample["sequence"] for sample in event["capture"]] == [4, 5, 6, 7, 8]
    first = event["capture"][0]
    assert first["misfit"] == 500.0
    assert [channel["deflection_mm"] for channel in first["channels"]] == wedged
    assert [channel["name"] for channel in first["channels"] if channel["explained_without"]] == ["s3"]
    assert first["channels"][2]["misfit_without"] == 0.0


def test_a_stretch_keeps_nothing_of_a_channel_that_took_no_part() -> None:
    wedged: Row = [0.5, 0.25, 0.75, 0.125]
    bench = Bench(surface_of(channels=4))
    bench.send([0.0] * 4, members={"oldest": 1})
    quality = ["good", "stuck", "good", "good"]
    bench.send(*[wedged] * 9, sequence=2, quality=quality, begin_us=START_US + 5000, members={"oldest": 1})
    (event,) = bench.get("/events?path=true").json()["events"]
    assert [[one["name"] for one in sample["channels"]] for sample in event["capture"]] == [["s1", "s3", "s4"]] * 5


@pytest.mark.promise(
    "docs/reference/events.md",
    "Misfit of the best single contact without this channel; null where too few channels would be left.",
)
def test_of_three_channels_a_stretch_does_not_say_which_one_is_wrong(bench: Bench) -> None:
    (event,) = story_of(bench, [RESTING, *[ODD] * 20, *[RESTING] * 4]).events
    for sample in event["capture"]:
        each = [(one["misfit_without"], one["explained_without"]) for one in sample["channels"]]
        assert each == [(None, False)] * 3


@pytest.mark.parametrize(
    ("before", "after"),
    [(ODD, [RESTING] * 2), (TOUCHING, [ODD] * 2), (TOUCHING, [BETWEEN]), (TOUCHING, [BETWEEN, ODD, BETWEEN])],
    ids=["rest after a stretch", "odd after a contact", "weak after a contact", "changing after a contact"],
)
def test_the_first_samples_after_a_gap_make_no_event_by_themselves(bench: Bench, before: Row, after: list[Row]) -> None:
    """None of them shows by itself what came before the gap."""
    story = Story(bench, [RESTING, *[before] * 5, RESTING, *after])
    story.deliver(0, 6)
    story.oldest = 8  # the one before is lost
    story.deliver(7, 7 + len(after))
    kind, begin = ("contact", "touch") if before is TOUCHING else ("unexplained", "clear")
    assert [one[:3] for one in told(story)] == [(kind, begin, "unseen")]
