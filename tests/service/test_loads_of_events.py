"""An event is an estimate of its load: which samples count in its figures, and its times."""

from math import nextafter
from typing import Any

import numpy as np
import pytest

from beamtouch_common.outline import Span
from beamtouch_models.runtime import Evidence, State, Weighed
from beamtouch_service.record.events.load import Load, Sighting, sighting_of
from beamtouch_service.samples import Sample
from beamtouch_service.surfaces.contact import Figures
from beamtouch_service.surfaces.estimate import Estimate
from beamtouch_service.surfaces.follower import Decision
from service.bench import START_US, Bench, Row, batch_of
from service.event_story import MOVING, RESTING, STILL, TOUCHING, Story, send


def at(place_mm: float, force_n: float) -> Row:
    """Return deflections of which the small model makes these figures."""
    total, moment = force_n / 10, (place_mm - 100) / 100
    return [total - moment, moment, 0.0]


def event_of(bench: Bench, rows: list[Row]) -> dict[str, Any]:
    """Return the event of samples 5 ms apart, with its path."""
    story = Story(bench, [RESTING, *rows, RESTING])
    story.deliver(0, len(story.rows))
    (event,) = story.events
    return event


def test_a_figure_is_within_its_interval_even_if_the_best_sample_has_nothing_in_common_with_others(
    bench: Bench,
) -> None:
    event = event_of(bench, [*[at(150, 10)] * 100, at(151.9, 10), at(149.5, 9.5)])
    assert len(event["path"]) == 1
    for name in ("mean_position{}_mm", "mean_force{}_n", "peak_force{}_n"):
        low, middle, high = (event[name.format(end)] for end in ("_low", "", "_high"))
        assert low <= middle <= high
    assert event["mean_position_mm"] == pytest.approx(150.0, abs=1.0)


@pytest.mark.promise("docs/reference/events.md", "and so has a contact that slid so slowly that it makes one stay")
def test_a_load_that_slides_slowly_is_at_its_mean_place_and_not_at_that_of_its_best_sample(bench: Bench) -> None:
    """Its samples have something in common, and all are unsteady."""
    body = batch_of(RESTING, *[at(150, 10)] * 10, *[at(151.5, 10)] * 30, RESTING, begin_us=START_US)
    for sample in body["samples"][1:-1]:
        sample |= {"readings": 50, "covariance_mm2": [1e-3, 0.0, 1e-3, 0.0, 0.0, 1e-3]}
    bench.send(members=body | {"oldest": 1, "noise_mm": [0.01] * 3})
    (event,) = bench.get("/events?path=true").json()["events"]
    assert (len(event["path"]), event["unsteady"]) == (1, True)
    assert event["mean_position_mm"] == pytest.approx(151.15, abs=0.02)
    assert event["mean_position_high_mm"] - event["mean_position_low_mm"] == pytest.approx(2.0, abs=1e-3)


@pytest.mark.promise(
    "docs/reference/events.md",
    "those of the largest force and of the places farthest left and right stay.",
)
def test_the_largest_force_and_the_farthest_places_of_a_long_contact_stay_on_record(bench: Bench) -> None:
    """They last shortly, and the path has no room for all of its changes."""
    sway = [*[at(200, 5)] * 8, *[at(200, 8)] * 8]
    rows = [*sway * 5, *[at(200, 18)] * 3, *sway * 10, *[at(120, 6)] * 3, *sway * 10, *[at(280, 6)] * 3, *sway * 15]
    event = event_of(bench, rows)
    assert len(event["path"]) <= 25
    assert event["peak_force_n"] == pytest.approx(18.0)
    assert (event["min_position_mm"], event["max_position_mm"]) == pytest.approx((120.0, 280.0))
    assert event["mean_force_n"] == pytest.approx(6.5, abs=0.1)


def test_a_clock_that_is_set_back_gives_no_negative_times(bench: Bench) -> None:
    rows = [RESTING, *[TOUCHING] * 5, *[at(200, 12)] * 5, *[TOUCHING] * 5, RESTING]
    body = batch_of(*rows, begin_us=START_US) | {"oldest": 1}
    for sample in body["samples"][6:]:
        sample["acquired_unix_us"] -= 60_000
    bench.send(members=body)
    (event,) = bench.get("/events?path=true").json()["events"]
    assert len(event["path"]) == 3
    assert all(point["lasts_ms"] >= 0 and point["at"] >= event["touched_at"] for point in event["path"])


@pytest.mark.promise(
    "docs/reference/events.md",
    "Without forces, these are the stays whose position has an interval of more than twice the width.",
)
def test_without_forces_the_ramps_are_stays_whose_place_is_known_less_well() -> None:
    load = Load(0)
    for number in range(44):
        is_whole = 2 <= number < 42
        place_mm, half_mm = (150.0, 1.0) if is_whole else (160.0, 3.0)
        now_us = number * 5000
        span = Span(place_mm, place_mm - half_mm, place_mm + half_mm)
        load.add(Sighting(now_us, now_us - 5000.0, (span,), 1 / half_mm**2, is_shown=True, is_unsteady=False))
    figures = load.figures
    assert figures is not None
    assert figures.along == (((150.0, 149.0, 151.0), 150.0, 150.0, None),)
    assert len(load.path) == 3


PRESSING: Row = [1.0, 0.5, 0.25]
SWINGING: Row = [1.6, 0.8, 0.4]


def figures(event: dict[str, Any]) -> tuple[float, ...]:
    names = ("mean_force_n", "peak_force_n", "mean_position_mm", "samples", "unsteady_samples", "unsteady")
    return tuple(event[name] for name in names)


@pytest.mark.promise(
    "docs/reference/events.md",
    (
        "A sample that alone does not show a contact, as while the beam swings far or after the lift, counts in no "
        "figure if others do."
    ),
)
@pytest.mark.parametrize("parts", [[10], [4, 6], [9, 1]])
def test_a_settled_sample_after_the_lift_is_no_part_of_the_load(bench: Bench, parts: list[int]) -> None:
    """All samples of the load are unsteady, as the beam rings."""
    swung: Row = [0.15, 0.0, 0.0]
    rows = [(RESTING, STILL), *[(PRESSING, MOVING)] * 7, (swung, STILL), (RESTING, STILL)]
    first = 0
    for count in parts:
        send(bench, *rows[first : first + count], sequence=first + 1)
        bench.get("/events")  # It writes what there is so far.
        first += count
    (event,) = bench.get("/events").json()["events"]
    assert figures(event) == (17.5, 17.5, 200.0, 8, 7, True)
    assert (event["peak_force_low_n"], event["peak_force_high_n"]) == (16.5, 18.5)


@pytest.mark.promise(
    "docs/reference/events.md",
    "A load that lies still makes one stay, with the figures of the sample that knows most.",
    "Swings of the beam make no stay, so they are no largest force.",
)
def test_the_sample_that_knows_most_counts_and_an_overshoot_within_its_interval_does_not(bench: Bench) -> None:
    knows: dict[str, Any] = {"readings": 50}
    above: Row = [0.53, 0.25, 0.125]
    send(bench, (RESTING, STILL), (above, STILL), (TOUCHING, knows), (above, STILL), (RESTING, STILL))
    (event,) = bench.get("/events").json()["events"]
    assert figures(event) == (8.75, 8.75, 150.0, 3, 0, False)
    assert (event["mean_position_low_mm"], event["mean_position_high_mm"]) == (149.0, 151.0)
    assert (event["min_position_mm"], event["max_position_mm"]) == (150.0, 150.0)


@pytest.mark.promise(
    "docs/reference/events.md",
    "Stays that are weaker than the next one inwards are ramps and no part of the load",
)
def test_the_ramps_of_touch_and_lift_are_not_the_load(bench: Bench) -> None:
    ramp = [[0.5 * part, 0.25 * part, 0.125 * part] for part in (0.4, 0.7)]
    send(bench, *((row, STILL) for row in [*[RESTING] * 6, *ramp, *[TOUCHING] * 20, *reversed(ramp), RESTING]))
    (event,) = bench.get("/events?path=true").json()["events"]
    assert figures(event) == (8.75, 8.75, 150.0, 24, 0, False)
    assert len(event["path"]) == 5


@pytest.mark.promise(
    "docs/reference/events.md", "if they last for less than a fifth of the contact at its begin, or at its end."
)
@pytest.mark.parametrize("is_lift", [False, True])
@pytest.mark.parametrize(("weak", "mean_n"), [(3, 8.75), (8, 7.0)])
def test_a_weak_begin_or_end_that_lasts_is_a_part_of_the_load(
    bench: Bench, is_lift: bool, weak: int, mean_n: float
) -> None:
    """Of 20 samples."""
    ramp: Row = [0.25, 0.125, 0.0625]
    rows = [*[ramp] * weak, *[TOUCHING] * (20 - weak)]
    send(bench, *((row, {"readings": 1}) for row in [RESTING, *(rows[::-1] if is_lift else rows), RESTING]))
    (event,) = bench.get("/events").json()["events"]
    assert event["mean_force_n"] == pytest.approx(mean_n, abs=0.15)
    assert event["peak_force_n"] == 8.75


@pytest.mark.promise(
    "docs/reference/events.md", "Least position of a load that moves. Of one that lies still, its position."
)
def test_the_mean_of_a_load_that_moves_is_that_of_its_path(bench: Bench) -> None:
    places = [[0.5 - 0.005 * step, 0.25 + 0.005 * step, 0.125] for step in range(21)]
    send(bench, (RESTING, STILL), *((row, STILL) for row in places), (RESTING, STILL))
    (event,) = bench.get("/events").json()["events"]
    assert event["mean_position_low_mm"] <= 155.0 <= event["mean_position_high_mm"]
    assert event["mean_position_mm"] == pytest.approx(155.0, abs=0.6)
    assert (event["min_position_mm"], event["max_position_mm"]) == pytest.approx((150.5, 159.5), abs=1.0)
    assert event["mean_force_n"] == 8.75


@pytest.mark.promise("docs/reference/events.md", "Time of the first clear reading after it")
def test_a_lift_is_at_the_first_clear_reading(bench: Bench) -> None:
    send(bench, (RESTING, STILL), *[(TOUCHING, STILL)] * 5, (RESTING, {"readings": 8}))
    (event,) = bench.get("/events").json()["events"]
    assert (event["touched_at"], event["lifted_at"]) == ("2026-11-20T23:40:00.200Z", "2026-11-20T23:40:00.665Z")
    assert event["dwell_ms"] == 465.0


def decision_of(log_odds: float, readings: int | None, figures: Figures | None) -> Decision:
    """Return the decision on a sample of the three of four channels that took part."""
    sample = Sample.model_validate(
        {"sequence": 1, "acquired_unix_us": 1_000_000, "deflection_mm": [0.5] * 4, "quality": ["good"] * 4}
        | {"readings": readings}
    )
    weights = np.diag([2.0, 3.0, 0.0, 4.0])
    evidence = Evidence(np.zeros(4), weights, {"contact_log_odds": log_odds}, 3, 0.0, False, 0.0, weights, True)
    together = Weighed(np.zeros((1, 4)), np.zeros((1, 4, 4)), np.zeros((1, 4)), np.ones((1, 4), bool))
    estimate = Estimate(sample, {}, evidence, together, 0, None)
    return Decision(estimate, State.CONTACT, State.CONTACT, is_certain=True, figures=figures)


PLACE = Figures({"position": Span(150.0, 149.0, 151.0)})
TOUCH = [1.0, 2.0, 3.0, 4.0]
"""Log odds above which a sample of one to four channels shows a contact."""


def test_a_sample_shows_a_contact_above_the_threshold_for_its_channels() -> None:
    for log_odds, is_shown in ((3.0, False), (nextafter(3.0, 4.0), True)):
        seen = sighting_of(decision_of(log_odds, None, PLACE), TOUCH, 5000.0)
        assert seen == Sighting(1_000_000, 1_000_000.0, (Span(150.0, 149.0, 151.0),), 29.0, is_shown, False)


@pytest.mark.parametrize(("readings", "begin_us"), [(None, 1_000_000.0), (1, 1_000_000.0), (3, 990_000.0)])
def test_a_sample_begins_with_its_first_reading(readings: int | None, begin_us: float) -> None:
    seen = sighting_of(decision_of(9.0, readings, PLACE._replace(force=Span(5.0, 4.0, 6.0))), TOUCH, 5000.0)
    assert seen is not None
    assert (seen.begin_us, seen.spans[1]) == (begin_us, Span(5.0, 4.0, 6.0))


def test_a_sample_without_a_place_sees_nothing() -> None:
    assert sighting_of(decision_of(9.0, None, None), TOUCH, 5000.0) is None
