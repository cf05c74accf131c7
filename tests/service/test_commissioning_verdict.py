"""The words of a commissioning, with the bounds between its findings: on wirings and places that are given."""

from collections.abc import Sequence
from math import isnan, nan

import numpy as np
import pytest

from beamtouch_models.runtime import State
from beamtouch_service.commissioning.report import Finding, PlaceResult
from beamtouch_service.commissioning.verdict import (
    advise,
    advise_places,
    advise_unseen,
    is_right,
    judge_place,
    judge_sensors,
)
from beamtouch_service.commissioning.wiring import Explanation, Wiring
from beamtouch_service.samples import Quality

NAMES = ["s1", "s2", "s3", "s4", "s5"]


def explanation(
    sensors: Sequence[int],
    signs: Sequence[int],
    shares: Sequence[float] = (),
    rivals: Sequence[Wiring] = (),
    *,
    is_explained: bool = True,
) -> Explanation:
    """Return what presses show: a wiring in which each channel moves as far as its sensor, unless it says otherwise."""
    each = np.array(shares or signs, np.float64)
    return Explanation(Wiring(tuple(sensors), tuple(signs)), list(rivals), is_explained, [], each)


def advice(explained: Explanation, bad: dict[str, Quality] | None = None, kind: str = "beam") -> list[str]:
    names = NAMES[: len(explained.wiring.signs)]
    return advise(explained, names, judge_sensors(explained, names, bad or {}), kind)


@pytest.mark.parametrize(
    ("sign", "share", "finding", "says"),
    [
        (1, 0.8, Finding.RIGHT, "moves as it should"),
        (1, 1.25, Finding.RIGHT, "moves as it should"),
        (1, 0.79, Finding.GAIN, "moves as it should, but 79 % as far"),
        (1, 1.26, Finding.GAIN, "moves as it should, but 126 % as far"),
        (-1, -0.8, Finding.INVERTED, "moves the wrong way"),
        (-1, -1.25, Finding.INVERTED, "moves the wrong way"),
        (-1, -1.26, Finding.GAIN, "moves the wrong way, but 126 % as far"),
        (0, 0.2, Finding.DEAD, "does not move"),
        (0, -0.2, Finding.DEAD, "does not move"),
        (0, 0.21, Finding.GAIN, "hardly moves: 21 % as far as it should"),
        (0, -0.55, Finding.GAIN, "hardly moves: -55 % as far as it should"),
        (1, nan, Finding.UNSURE, "the presses hardly move it: nothing can be said"),
    ],
)
def test_a_channel_is_right_from_four_fifths_of_its_movement_to_five_quarters_and_dead_up_to_a_fifth(
    sign: int, share: float, finding: Finding, says: str
) -> None:
    explained = explanation((0, 1, 2), (1, sign, 1), (1.0, share, 1.0))
    assert judge_sensors(explained, NAMES[:3], {})[1] == (finding, says)
    unexplained = judge_sensors(explained._replace(is_explained=False), NAMES[:3], {})[1]
    assert unexplained.finding is Finding.UNSURE
    if not isnan(share):
        assert unexplained.says == f"no wiring explains the presses; it moves {100 * share:.0f} % as far as it should"


def test_a_swapped_channel_says_whose_movement_it_shows_and_which_way() -> None:
    explained = explanation((2, 1, 0), (1, 1, -1))
    assert judge_sensors(explained, NAMES[:3], {}) == [
        (Finding.SWAPPED, "moves as s3 should"),
        (Finding.RIGHT, "moves as it should"),
        (Finding.SWAPPED, "moves as s1 should, the wrong way"),
    ]


def test_a_dead_channel_says_its_quality_and_another_one_does_not() -> None:
    explained = explanation((0, 1, 2), (0, 1, 0))
    assert judge_sensors(explained, NAMES[:3], {"s1": Quality.MISSING, "s2": Quality.STUCK}) == [
        (Finding.DEAD, "does not move (missing)"),
        (Finding.RIGHT, "moves as it should"),
        (Finding.DEAD, "does not move"),
    ]


def test_only_of_a_channel_on_which_rivals_differ_nothing_is_sure() -> None:
    """The best rival is named. A wrong gain is certain under each."""
    rivals = [Wiring((0, 1, 2), (1, -1, 1)), Wiring((0, 1, 2), (1, 0, 1)), Wiring((0, 1, 2), (1, 1, -1))]
    explained = explanation((0, 1, 2), (1, 1, 1), (1.0, 1.0, 0.6), rivals)
    assert judge_sensors(explained, NAMES[:3], {}) == [
        (Finding.RIGHT, "moves as it should"),
        (Finding.UNSURE, "not sure: moves as it should, or moves the wrong way"),
        (Finding.GAIN, "moves as it should, but 60 % as far"),
    ]
    assert advice(explained) == [
        "Not sure about s2 (s2: moves as it should, or moves the wrong way). Press more firmly, exactly above each "
        "sensor.",
        "s3 moves 60 % as far as it should, next to the others. Check its gap and its characteristic.",
    ]


def test_each_fault_of_a_sensor_is_a_sentence_with_what_to_do() -> None:
    assert advice(explanation((0, 1, 2), (1, 1, 1))) == []
    feeler = (
        "the wrong way. Measure the characteristic with two feeler gauges, and correct gain_mm_per_count and offset_mm "
        "of the channel."
    )
    assert advice(explanation((0, 1, 2), (1, -1, 1))) == [f"s2 moves {feeler}"]
    assert advice(explanation((0, 1, 2, 3), (-1, -1, 0, -1))) == [
        f"s1, s2 and s4 move {feeler}",
        "s3 does not move. Check its cable, its supply, its input and its gap.",
    ]
    # Of an inverted one that is not sure, only that.
    unsure = explanation((0, 1, 2), (1, -1, -1), (1.0, nan, -1.3))
    assert advice(unsure) == [
        "Not sure about s2 (s2: the presses hardly move it: nothing can be said). Press more firmly, exactly above "
        "each sensor.",
        f"s3 moves {feeler}",
        "s3 moves 130 % as far as it should, next to the others. Check its gap and its characteristic.",
    ]


@pytest.mark.parametrize(
    ("sensors", "sentences"),
    [
        ((0, 3, 2, 1), ["The cables of s2 and s4 are swapped. Swap them back."]),
        ((2, 1, 0), ["The cables of s1 and s3 are swapped. Swap them back."]),
        (
            (3, 2, 1, 0),
            [
                "The channels are in reverse order. Check from which end the sensors are numbered, and the order in "
                "the daemon's configuration."
            ],
        ),
        (
            (1, 0, 3, 4, 2),
            [
                "The cables of s1 and s2 are swapped. Swap them back.",
                "Cables are mixed up: the input of s3 has the sensor s4, that of s4 has the sensor s5, that of s5 has "
                "the sensor s3.",
            ],
        ),
    ],
)
def test_mixed_cables_are_named_as_pairs_where_they_are_pairs(sensors: tuple[int, ...], sentences: list[str]) -> None:
    assert advice(explanation(sensors, [1] * len(sensors))) == sentences


def test_of_two_swapped_cables_of_which_one_is_not_sure_the_other_is_named() -> None:
    explained = explanation((1, 0, 2), (1, 1, 1), (nan, 1.0, 1.0))
    assert advice(explained)[1:] == ["Cables are mixed up: the input of s2 has the sensor s1."]


def test_presses_that_no_wiring_explains_say_where_to_look() -> None:
    begin = (
        "No wiring explains the presses. Check that each press was above its sensor, that nothing else touched the "
        "plate, and that the model is that of this plate."
    )
    shares = (0.79, 0.81, -1.24, 1.26, nan)
    unexplained = explanation(range(5), [1] * 5, shares, is_explained=False)
    look = " Look first at s1 and s4: the movement is not in proportion to the others."
    assert advice(unexplained, kind="plate") == [begin + look]
    assert advice(explanation((0, 1), (1, 1), is_explained=False), kind="plate") == [begin]


def test_presses_that_were_not_seen_are_named() -> None:
    assert advise_unseen([], "beam") == []
    for names, listed in ((["s2"], "s2"), (["s2", "s4"], "s2 and s4"), (["s1", "s2", "s4"], "s1, s2 and s4")):
        assert advise_unseen(names, "plate") == [
            f"The press above {listed} was not seen. If you did press firmly, check that the daemon reads this "
            "surface, and that the plate bends there."
        ]


def judged(at_mm: tuple[float, float], stated_mm: tuple[float, float], half_mm: float = 1.5) -> PlaceResult:
    """Return a place of a plate whose coordinates are stated so, with intervals of this half-width."""
    stated = {axis: (one, one - half_mm / 2, one + 1.5 * half_mm) for axis, one in zip("xy", stated_mm, strict=True)}
    place = PlaceResult(at_mm=dict(zip("xy", at_mm, strict=True)), state=State.CONTACT, stated_mm=stated)
    return judge_place(place)


def test_a_place_may_be_off_by_five_millimetres_and_half_its_interval_along_each_axis() -> None:
    within = judged((100.0, 40.0), (106.5, 33.5))
    assert (within.error_mm, within.allowed_mm) == ({"x": 6.5, "y": -6.5}, {"x": 6.5, "y": 6.5})
    assert within.says == "x +6.5 mm, within 6.5 mm; y -6.5 mm, within 6.5 mm"
    assert is_right(within)
    for stated_mm, says in (
        ((106.75, 40.25), "x +6.8 mm, more than 6.5 mm; y +0.2 mm, within 6.5 mm"),
        ((99.0, 33.25), "x -1.0 mm, within 6.5 mm; y -6.8 mm, more than 6.5 mm"),
    ):
        beyond = judged((100.0, 40.0), stated_mm)
        assert beyond.says == says
        assert not is_right(beyond)
    # To 0.1 um, as positions are stated.
    exact = judged((100.0, 40.0), (101.23454, 40.0), half_mm=1.00013)
    assert exact.error_mm == {"x": 1.2345, "y": 0.0}
    assert exact.allowed_mm == {"x": 6.0001, "y": 6.0001}


def test_a_place_without_a_position_says_why_and_is_not_right() -> None:
    at_mm = {"position": 120.0}
    silent = judge_place(PlaceResult(at_mm=at_mm), "no samples")
    assert (silent.says, silent.error_mm) == ("no samples", None)
    clear = judge_place(PlaceResult(at_mm=at_mm, state=State.CLEAR), "no samples")
    assert (clear.says, clear.error_mm) == ("no position: clear", None)
    assert not is_right(clear)
    assert advise_places([silent, judged((100.0, 40.0), (101.0, 38.0)), clear], is_wired=True) == [
        "At 120 mm: no samples.",
        "At 120 mm: no position: clear.",
        "The largest error of a position is 2.0 mm.",
    ]


AIM = "This is more than aim explains. Repeat the commissioning; if it stays so, calibrate the model."
OTHER_POINT = "the marks may count from another point."


@pytest.mark.parametrize(
    ("errors_mm", "advised"),
    [
        # Right along one axis, and as much too large along the other: 9 to 15 mm differ by half of their mean.
        ([(1.0, 9.0), (-2.0, 15.0)], [f"All figures of y are about 12 mm too large: {OTHER_POINT}"]),
        ([(1.0, 8.9), (-2.0, 15.0)], [AIM]),
        ([(-9.0, 1.0), (-15.0, 0.5)], [f"All figures of x are about 12 mm too small: {OTHER_POINT}"]),
        ([(-9.0, 1.0)], [AIM]),
        (
            [(-9.0, 20.0), (-10.0, 22.0), (-11.0, 27.0)],
            [
                f"All figures of x are about 10 mm too small: {OTHER_POINT}",
                f"All figures of y are about 23 mm too large: {OTHER_POINT}",
            ],
        ),
        ([(-9.0, 20.0), (-10.0, -22.0)], [AIM]),
        ([(6.5, -6.5), (6.0, 1.0)], []),
    ],
)
def test_errors_that_are_alike_at_all_marks_say_that_the_marks_count_from_another_point(
    errors_mm: list[tuple[float, float]], advised: list[str]
) -> None:
    places = [judged((100.0, 40.0), (100.0 + along_x, 40.0 + along_y)) for along_x, along_y in errors_mm]
    largest_mm = max(abs(error_mm) for each in errors_mm for error_mm in each)
    largest = f"The largest error of a position is {largest_mm:.1f} mm."
    assert advise_places(places, is_wired=True) == [largest, *advised]
    assert advise_places(places, is_wired=False) == [
        largest,
        "Positions mean little until every sensor moves as it should. Put that right, and repeat.",
    ]


def test_a_place_of_a_plate_is_named_by_both_coordinates() -> None:
    place = PlaceResult(at_mm={"x": 120.5, "y": 33.0}, state=State.UNEXPLAINED)
    assert advise_places([judge_place(place)], is_wired=True) == ["At 120.5, 33 mm: no position: unexplained."]
