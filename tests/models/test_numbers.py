"""Numbers that scripts give, numbers with their standard errors as people read them, and places."""

import math

import numpy as np
import pytest
from numpy.typing import ArrayLike

from beamtouch_models.errors import SceneError
from beamtouch_models.numbers import (
    array_of,
    at_least,
    at_most,
    number,
    numbers,
    places_in,
    places_within,
    rounded,
    whole,
    with_error,
)
from beamtouch_models.places import Extent, along_axis, as_stated, distances_mm, in_rows, in_words, positions_of


@pytest.mark.parametrize(
    ("value", "error", "text"),
    [
        (4.7123, 0.0812, "4.71 +- 0.08"),
        (4.7123, 0.0960, "4.7 +- 0.1"),
        (4.7123, 0.812, "4.7 +- 0.8"),
        (47.123, 3.4, "47 +- 3"),
        (471.23, 34.0, "471 +- 30"),
        (0.0047123, 0.00034, "0.0047 +- 0.0003"),
        (-3.0, 0.25, "-3.0 +- 0.2"),
        (1.00002, 0.0000031, "1.000 +- <0.001"),
        (20.0, 0.0061, "20.00 +- 0.006"),
        (20.0, 0.0041, "20.00 +- <0.01"),
        (200_000.0, 3.0, "200000 +- <100"),
        (200.0, 0.6, "200.0 +- 0.6"),
        (0.0, 0.0004, "0.000 +- <0.001"),
        (0.0, 0.0006, "0.000 +- 0.0006"),
        (1.23456, 0.0, "1.23"),
        (1.23456, math.inf, "1.23"),
        (math.inf, 0.1, "inf"),
        (1.23456, math.nan, "1.23"),
    ],
)
def test_a_value_has_the_digits_that_its_error_leaves(value: float, error: float, text: str) -> None:
    assert with_error(value, error) == text
    assert rounded(value, error) == text.split(" ", maxsplit=1)[0]
    assert with_error(value, error, "±", " mm") == f"{text.replace('+-', '±')} mm"


@pytest.mark.parametrize(
    ("value", "below", "above"),
    [
        (0.0237, 0.023, 0.024),
        (23.7, 23.0, 24.0),
        (9.95, 9.9, 10.0),
        (237e-300, 230e-300, 240e-300),
        (99.99999999999999, 99.0, 100.0),
        *((number, number, number) for number in (0.29, 0.07, 5.8, 1000.0, 0.0, 1.1e-305)),
    ],
)
def test_bounds_have_two_digits_and_are_on_their_side(value: float, below: float, above: float) -> None:
    assert (at_most(value), at_least(value)) == (below, above)


def test_a_bound_beyond_the_largest_float_is_infinite() -> None:
    assert at_least(1.79e308) == math.inf


def test_arguments_are_numbers_within_their_bounds_ends_included() -> None:
    assert numbers([3, 7.5], "x", least=3.0, most=7.5).tolist() == [3.0, 7.5]
    assert numbers(4, "x").tolist() == [4.0]
    assert numbers([True, False], "x").tolist() == [1.0, 0.0]
    for values, said in (
        ([3, 7.6], "x: must be finite from 3 to 7.5 (given: 7.6)"),
        ([2.9, 8], "x: must be finite from 3 to 7.5 (given: 2.9)"),
        ([], "x: must be one number, or a list of them that is not empty"),
        ([[3, 4]], "x: must be one number, or a list of them that is not empty"),
        ("ab", "x: must be numbers (given: 'ab')"),
        ([[1], [2, 3]], "x: must be numbers (given: [[1], [2, 3]])"),
        ("y" * 60, f"x: must be numbers (given: '{'y' * 39})"),
    ):
        with pytest.raises(SceneError) as refused:
            numbers(values, "x", least=3.0, most=7.5)
        assert str(refused.value) == said
    with pytest.raises(SceneError, match=r"^x: must be finite, at least 2 \(given: 1\)$"):
        numbers([1.0], "x", least=2.0)
    with pytest.raises(SceneError, match=r"^x: must be finite \(given: inf\)$"):
        numbers([math.inf], "x")


def test_an_array_may_have_any_shape() -> None:
    assert array_of([[1, 2], [3, 4]], "x").tolist() == [[1.0, 2.0], [3.0, 4.0]]
    assert array_of(np.zeros((2, 3, 1), np.float32), "x").dtype == np.float64


def test_a_single_number_is_one() -> None:
    assert number([7.5], "x") == 7.5
    with pytest.raises(SceneError, match=r"^x: must be one number$"):
        number([7.5, 8], "x")


@pytest.mark.parametrize("value", [3, np.int64(3)])
def test_a_whole_number_may_be_the_least(value: object) -> None:
    assert whole(value, "n", 3) == 3


@pytest.mark.parametrize("value", [2, 3.0, "3", True, None])
def test_what_is_not_whole_or_too_small_is_refused(value: object) -> None:
    with pytest.raises(SceneError) as refused:
        whole(value, "n", 3)
    assert str(refused.value) == f"n = {value!r}: give a whole number, 3 or more"


def test_places_lie_within_their_bounds() -> None:
    assert places_in([0, 400], "p", 400.0).tolist() == [0.0, 400.0]
    low, high = np.array([1.0, 20.0]), np.array([9.0, 30.0])
    assert places_within([3, 4], "p", low[:1], high[:1]).tolist() == [[3.0], [4.0]]
    assert places_within([3, 24], "p", low, high).tolist() == [[3.0, 24.0]]
    assert places_within([[1, 30], [9, 20]], "p", low, high).tolist() == [[1.0, 30.0], [9.0, 20.0]]
    wrong: tuple[ArrayLike, ...] = ([], [1, 2, 3], [[[3, 24]]], [[1], [2]])
    for places in wrong:
        with pytest.raises(SceneError, match=r"^p: give 2 numbers for each place, x and y$"):
            places_within(places, "p", low, high)
    for place, said in (([[3, 31]], "from 20 to 30"), ([[0.5, 24]], "from 1 to 9")):
        with pytest.raises(SceneError, match=f"^p: must be finite {said}"):
            places_within(place, "p", low, high)
    for position in ([400.5], [-0.5]):
        with pytest.raises(SceneError, match=r"^p: must be finite from 0 to 400"):
            places_in(position, "p", 400.0)


EXTENT = Extent(((10.0, 40.0), (100.0, 160.0)))


def test_a_grid_has_about_as_many_places_as_asked_for_on_the_rims_and_between() -> None:
    ticks = EXTENT.ticks(10)  # about the root of ten along each axis
    assert [tick.tolist() for tick in ticks] == [[10.0, 25.0, 40.0], [100.0, 130.0, 160.0]]
    assert [len(tick) for tick in EXTENT.ticks(1)] == [2, 2]  # at least its ends
    assert EXTENT.grid(9)[:4].tolist() == [[10.0, 100.0], [10.0, 130.0], [10.0, 160.0], [25.0, 100.0]]
    assert [along_axis(count, 1) for count in (0, 1, 7)] == [1, 1, 7]
    assert [along_axis(count, 2) for count in (0, 2, 3, 49)] == [1, 1, 2, 7]


def test_middles_are_those_of_equal_parts() -> None:
    assert [ticks.tolist() for ticks in EXTENT.middle_ticks(3)] == [[15.0, 25.0, 35.0], [110.0, 130.0, 150.0]]
    assert EXTENT.middles(3)[:2].tolist() == [[15.0, 110.0], [15.0, 130.0]]
    assert Extent.of_beam((0.0, 8.0)).middles(2).tolist() == [[2.0], [6.0]]


def test_places_of_an_extent_by_shares_and_at_random() -> None:
    assert EXTENT.at(np.array([[0.25], [1.0]])).tolist() == [[17.5, 115.0], [40.0, 160.0]]
    assert EXTENT.size_mm.tolist() == [30.0, 60.0]
    drawn = EXTENT.uniform(4000, np.random.default_rng(1))
    assert drawn.shape == (4000, 2)
    assert drawn.min(axis=0) == pytest.approx([10, 100], abs=0.2)
    assert drawn.max(axis=0) == pytest.approx([40, 160], abs=0.2)
    assert drawn.mean(axis=0) == pytest.approx([25, 130], abs=1.5)


def test_only_a_beam_has_positions() -> None:
    assert Extent.of_beam((3.0, 8.0)).range_mm == (3.0, 8.0)
    assert positions_of(np.array([[3.0], [8.0]])).tolist() == [3.0, 8.0]
    with pytest.raises(ValueError, match="a range of positions is of one axis, here are 2"):
        _ = EXTENT.range_mm
    with pytest.raises(ValueError, match="positions are of one axis, here are 2"):
        positions_of(np.zeros((3, 2)))


def test_places_as_stated_in_rows_in_words_and_apart() -> None:
    assert as_stated(np.array([[3.0], [8.0]])).tolist() == [3.0, 8.0]
    assert as_stated(np.array([[3.0, 8.0]])).tolist() == [[3.0, 8.0]]
    assert in_rows([3, 8], 1).tolist() == [[3.0], [8.0]]
    assert in_rows([3, 8, 1, 2], 2).tolist() == [[3.0, 8.0], [1.0, 2.0]]
    assert (in_words(120.5), in_words([120.5, 80])) == ("120.5", "(120.5, 80)")
    assert distances_mm(np.array([[3.0, -4.0], [-5.0, 12.0]])).tolist() == [5.0, 13.0]
    assert distances_mm(np.array([[-7.0]])).tolist() == [7.0]
