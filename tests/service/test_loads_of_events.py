"""The figures of events whose samples contradict each other, go on for long, or have odd clocks."""

from typing import Any

import pytest

from beamtouch_common.zones import Span
from beamtouch_service.events.load import Load, Sighting
from service.bench import START_US, Bench, Row, batch_of
from service.event_story import RESTING, TOUCHING, Story


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
    assert figures.position == (150.0, 149.0, 151.0)
    assert (figures.least_mm, figures.most_mm) == (150.0, 150.0)
    assert len(load.path) == 3
