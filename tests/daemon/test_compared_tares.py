"""What a tare is compared with, and what is said of gaps that differ: a load, warmth, swapped cables, a new sensor."""

import math

import pytest

from beamtouch_daemon.config.settings import Surface
from beamtouch_daemon.measuring.tares import (
    common_mm,
    describe_comparison,
    find_contradictions,
    find_moved,
    largest_change_mm,
)

from .surfaces import NOISE_MM, surface_of

LAST = {"s1": 2.5, "s2": 2.2, "s3": 2.9, "s4": 2.6}
PLAIN = surface_of(4)
"""0.3 mm from the configuration and 0.06 mm from the last tare are allowed."""
UNLIMITED = "; a load that moves less is not noticed, as the channels state no smallest_force_mm"
HOUR_S = 3600.0


def warm(um_per_min: float = 4.0, max_mm: float = 0.5, channels: int = 4, **changes: object) -> Surface:
    """Return a surface whose zeros drift with warmth."""
    tracking = {"drift_um_per_min": um_per_min, "max_mm": max_mm}
    return surface_of(channels, noise_mm=NOISE_MM, zero_tracking=tracking, **changes)


def moved(*by_mm: float) -> dict[str, float]:
    return {name: gap_mm + differs for (name, gap_mm), differs in zip(LAST.items(), by_mm, strict=False)}


@pytest.mark.parametrize(
    ("channel", "share", "largest_mm"),
    [
        ({}, 0.03, 0.09),
        ({"smallest_force_mm": 0.7}, 0.03, 0.07),
        ({"smallest_force_mm": 1.2}, 0.03, 0.09),
    ],
)
def test_a_change_is_limited_by_the_range_or_the_smallest_force(
    channel: dict[str, object], share: float, largest_mm: float
) -> None:
    assert largest_change_mm(surface_of(1, channel).channels[0], share) == pytest.approx(largest_mm)


def test_each_gap_that_differs_is_named_with_its_difference() -> None:
    assert find_contradictions(moved(0.05, -0.07, 0.1, 0.061), LAST, PLAIN) == [
        "s2 -0.070 mm from the last tare",
        "s3 +0.100 mm from the last tare",
        "s4 +0.061 mm from the last tare",
    ]
    first = {"s1": 2.5, "s2": 2.81, "s3": 2.1, "s4": 2.79}
    assert find_contradictions(first, {}, PLAIN) == [
        "s2 +0.310 mm from its rest_gap_mm",
        "s3 -0.400 mm from its rest_gap_mm",
    ]


def test_the_noise_of_a_reading_is_allowed_too_and_small_limits_have_more_digits() -> None:
    surface = surface_of(4, {"smallest_force_mm": 0.0005}, noise_mm=0.0003)
    assert find_contradictions(moved(0.00034, 0.00036, 0.0, 0.0), LAST, surface) == ["s2 +0.0004 mm from the last tare"]


@pytest.mark.parametrize(
    ("now", "is_swapped"),
    [
        ({"s2": 2.9, "s3": 2.2}, True),
        ({"s2": 2.95, "s3": 2.25}, True),
        ({"s2": 2.97, "s3": 2.2}, False),
        ({"s2": 2.9, "s3": 2.27}, False),
        ({"s2": 2.83, "s3": 2.2}, False),
        ({"s2": 2.9}, False),
        ({"s2": 2.9, "s3": 2.2, "s1": 2.6}, False),  # three gaps differ
    ],
)
def test_two_gaps_that_changed_places_are_swapped_cables(now: dict[str, float], is_swapped: bool) -> None:
    found = find_contradictions(LAST | now, LAST, PLAIN)
    said = "s2 and s3 have each other's rest gaps, so their cables seem to be swapped"
    assert (said in found) == is_swapped
    assert len(found) == len(now) + is_swapped


def test_cables_are_swapped_too_if_there_was_no_tare() -> None:
    surface = surface_of(2, channels=[channel.model_dump(by_alias=True) for channel in PLAIN.channels[:2]])
    first, second = surface.channels
    surface = surface.model_copy(update={"channels": (first, second.model_copy(update={"rest_gap_mm": 3.5}))})
    assert find_contradictions({"s1": 3.52, "s2": 2.49}, {}, surface)[2:] == [
        "s1 and s2 have each other's rest gaps, so their cables seem to be swapped"
    ]


@pytest.mark.parametrize(
    ("by_mm", "common"),
    [
        ((0.10, 0.12, 0.09, 0.11), 0.105),
        ((-0.10, -0.12, -0.09, -0.11), -0.105),
        ((0.2, 0.2, 0.2, 0.259), 0.2),  # within 30 % of the others, or 0.06 mm
        ((0.2, 0.2, 0.2, 0.261), 0.0),
        ((0.1, 0.1, 0.1, 0.159), 0.1),
        ((0.4, 0.4, 0.4, 0.285), 0.4),
        ((0.4, 0.4, 0.4, 0.275), 0.0),
        ((0.02, 0.02, -0.01, 0.02), 0.0),  # not all the same way
    ],
)
def test_gaps_that_have_all_changed_about_alike_have_a_common_change(by_mm: tuple[float, ...], common: float) -> None:
    assert common_mm(moved(*by_mm), LAST, PLAIN) == pytest.approx(common)


def test_two_channels_and_a_first_tare_show_no_common_change() -> None:
    three, two = surface_of(3), surface_of(2)
    assert common_mm(moved(0.2, 0.2, 0.2), LAST, three) == pytest.approx(0.2)
    assert common_mm(moved(0.2, 0.2), LAST, two) == 0.0
    assert common_mm(moved(0.2, 0.2, 0.2), {}, three) == 0.0


def test_a_sensor_that_moved_by_itself_since_the_last_tare_may_be_new() -> None:
    assert find_moved(moved(0.01, -0.07, 0.05, 0.0), LAST, PLAIN) == ["s2"]
    assert find_moved(moved(0.01, -0.07, 0.05, 0.0), {}, PLAIN) == []
    assert find_moved(moved(0.2, 0.21, 0.19, 0.2), LAST, PLAIN) == []  # all alike


def test_what_all_gaps_have_in_common_is_warmth_as_far_as_it_can_have_come() -> None:
    # In an hour a common walk of 4 um a minute reaches 4 x 4 x sqrt(60) um with four deviations.
    far_mm = 0.1
    assert find_contradictions(moved(*[far_mm] * 4), LAST, warm(), HOUR_S) == []
    assert len(find_contradictions(moved(*[far_mm] * 4), LAST, PLAIN, HOUR_S)) == 4
    assert len(find_contradictions(moved(*[far_mm] * 4), LAST, warm(), 60.0)) == 4
    assert len(find_contradictions(moved(*[-far_mm] * 4), LAST, warm(), 60.0)) == 4
    assert find_contradictions(moved(*[-far_mm] * 4), LAST, warm(), HOUR_S) == []
    assert len(find_contradictions(moved(*[far_mm] * 4), LAST, warm(max_mm=0.03), HOUR_S)) == 4
    assert find_contradictions(moved(*[far_mm] * 3), LAST, warm(channels=3), HOUR_S) == []
    assert len(find_contradictions(moved(*[far_mm] * 2), LAST, warm(channels=2), HOUR_S)) == 2


def test_a_gap_is_compared_beyond_the_common_warmth() -> None:
    found = find_contradictions(moved(0.1, 0.1, 0.2, 0.1), LAST, warm(), HOUR_S)
    assert found == ["s3 +0.100 mm from the last tare"]
    assert find_moved(moved(0.1, 0.1, 0.2, 0.0), LAST, warm(), HOUR_S) == ["s3", "s4"]


@pytest.mark.parametrize(
    ("surface", "by_mm", "last", "said"),
    [
        (
            PLAIN,
            (0.01, -0.05, 0.02, 0.0),
            LAST,
            f"compared with the last tare: s2 differs most, by 0.05 mm; 0.06 mm are allowed{UNLIMITED}",
        ),
        (
            PLAIN,
            (0.0, 0.04, -0.25, 0.0),
            {},
            f"first tare, compared with rest_gap_mm: s2 differs most, by 0.26 mm; 0.3 mm are allowed{UNLIMITED}",
        ),
        (
            surface_of(4, {"smallest_force_mm": 0.2}),
            (0.0, 0.0, 0.015, 0.0),
            LAST,
            "compared with the last tare: s3 differs most, by 0.015 mm; 0.02 mm are allowed",
        ),
        (
            warm(),
            (0.1, 0.1, 0.14, 0.1),
            LAST,
            "compared with the last tare: s3 differs most, by 0.04 mm; 0.062 mm are allowed; all gaps changed by about "
            "+0.100 mm, taken for warmth: a load that moves all sensors about alike would pass, too, so look at the "
            f"beam{UNLIMITED}",
        ),
        (
            warm(),
            (-0.06, -0.06, -0.06, -0.055),
            LAST,
            f"compared with the last tare: s4 differs most, by 0.005 mm; 0.062 mm are allowed{UNLIMITED}",
        ),
    ],
    ids=["last", "first", "light", "warm", "little warmth"],
)
def test_a_tare_that_is_taken_says_how_closely_it_was_compared(
    surface: Surface, by_mm: tuple[float, ...], last: dict[str, float], said: str
) -> None:
    assert describe_comparison(moved(*by_mm), last, surface, HOUR_S) == said


def test_the_age_of_the_last_tare_need_not_be_known() -> None:
    assert find_contradictions(moved(*[0.45] * 4), LAST, warm()) == []
    assert find_moved(moved(0.1, 0.1, 0.2, 0.0), LAST, warm(), math.inf) == ["s3", "s4"]
