"""The smallest changes that counts show, by their type and by what came."""

import math

import numpy as np
import pytest

from beamtouch_daemon.processing.resolution import changes_shown, finest, steps_shown, tolerance

from .surfaces import CHANNEL, surface_of


def mixed(*types: str) -> list[dict[str, object]]:
    return [CHANNEL | {"name": f"s{at}", "register": 4 * at, "type": kind} for at, kind in enumerate(types)]


@pytest.mark.parametrize(
    ("value_type", "spacing"),
    [("u16", 1.0), ("i32", 1.0), ("f32", 2.0**-8), ("f64", 2.0**-37)],  # IEEE 754: 24 and 53 bits up to 35 000 counts
)
def test_a_type_is_as_fine_as_its_last_digit_at_the_end_of_the_range(value_type: str, spacing: float) -> None:
    assert finest(surface_of(1, {"type": value_type})).tolist() == [spacing]


def test_fractional_numbers_are_equal_within_two_of_their_last_digits_and_whole_ones_if_they_are() -> None:
    assert tolerance(surface_of(channels=mixed("u16", "f32", "f64"))).tolist() == [0.0, 2.0**-7, 2.0**-36]


def test_changes_are_those_between_neighbouring_values_that_differ() -> None:
    nan = math.nan
    counts = np.array(
        [[7.0, 20_000.0, 5.0], [3.0, 20_000 + 2.0**-7, 5.0], [nan, 20_000.25, nan], [12.0, 20_000.0, 5.0]]
    )
    surface = surface_of(channels=mixed("u16", "f32", "u16"))
    assert [changes.tolist() for changes in changes_shown(counts, surface)] == [[4.0, 5.0], [0.25 - 2.0**-7], []]
    assert steps_shown(counts, surface).tolist() == [4.0, 0.25 - 2.0**-7, math.inf]
