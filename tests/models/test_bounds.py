"""The Cramer-Rao bound in closed form, for a bar on two scales: each carries the load by its lever."""

import dataclasses

import numpy as np
import pytest

from beamtouch_models.arrays import Floats
from beamtouch_models.design.accuracy.cramer_rao import (
    cramer_rao_deviation_mm,
    cramer_rao_error_mm,
    cramer_rao_errors_mm,
)
from beamtouch_models.design.accuracy.prior import Prior
from beamtouch_models.places import Extent
from beamtouch_models.runtime.error_model import Errors
from models.bar_on_scales import LENGTH_MM, scales

NOISE_MM = 0.004
SENSORS = Errors(NOISE_MM)
PLACE_MM, LOAD_N = np.array([[13.0], [52.0], [104.0]]), np.array([3.0, 7.0, 16.0])
SHARE = PLACE_MM[:, 0] / LENGTH_MM
FREE_MM = LENGTH_MM * NOISE_MM / LOAD_N * np.hypot(SHARE, 1 - SHARE)
"""Deviation of l d2 / (d1 + d2) where the force is open."""
EXACT_MM = LENGTH_MM * NOISE_MM / LOAD_N / 2**0.5
"""That of l/2 (1 + (d2 - d1) / F)."""


def bar(force_n: tuple[float, float], errors: Errors = SENSORS) -> Prior:
    return Prior(Extent.of_beam((0.0, LENGTH_MM)), LENGTH_MM, force_n, errors, 2, scales)


def test_an_open_force_costs_what_changes_along_the_shape() -> None:
    assert cramer_rao_deviation_mm(bar((2.0, 20.0)), PLACE_MM, LOAD_N)[:, 0] == pytest.approx(FREE_MM, rel=1e-6)


def test_an_exact_force_costs_nothing_and_a_nearly_known_one_a_part() -> None:
    for at_mm, load_n, exact_mm, free_mm in zip(PLACE_MM, LOAD_N, EXACT_MM, FREE_MM, strict=True):
        place, load = at_mm[None], np.array([load_n])
        exact = cramer_rao_deviation_mm(bar((load_n, load_n)), place, load)
        assert exact[0] == pytest.approx(exact_mm, rel=1e-6)
        if exact_mm < 0.99 * free_mm:
            nearly = cramer_rao_deviation_mm(bar((load_n - 0.01, load_n + 0.01)), place, load)
            assert 1.001 * exact_mm < nearly[0, 0] < 0.999 * free_mm


def test_errors_of_the_sensors_add_as_squares() -> None:
    zeros = Errors(NOISE_MM, zero_mm=NOISE_MM * 3**0.5)
    assert cramer_rao_deviation_mm(bar((2.0, 20.0), zeros), PLACE_MM, LOAD_N)[:, 0] == pytest.approx(
        2 * FREE_MM, rel=1e-6
    )


def test_the_mean_bound_is_that_of_a_normal_error_over_places_and_forces() -> None:
    """The mean of 1/F from 2 to 20 N is ln(10)/18, that of sqrt(u^2 + (1-u)^2) is (sqrt 2 + asinh 1)/(2 sqrt 2)."""
    expected = (2 / np.pi) ** 0.5 * LENGTH_MM * NOISE_MM * np.log(10) / 18
    prior = bar((2.0, 20.0))
    parts = cramer_rao_errors_mm(prior)
    assert cramer_rao_error_mm(prior) == pytest.approx(expected * (2**0.5 + np.arcsinh(1)) / 8**0.5, rel=2e-3)
    assert parts[[0, -1]] == pytest.approx(np.full(2, expected), rel=5e-3)
    assert parts[len(parts) // 2] == pytest.approx(expected * 0.5**0.5, rel=2e-3)
    assert parts.argmin() == len(parts) // 2


def test_a_bound_beyond_the_range_is_no_larger_than_a_guess() -> None:
    """At x, any place of 0 to l is off by (x^2 + (l-x)^2) / (2 l) on average."""
    hidden = cramer_rao_errors_mm(bar((2.0, 20.0), Errors(1e6)))
    assert hidden[[0, len(hidden) // 2, -1]] == pytest.approx([LENGTH_MM / 2, LENGTH_MM / 4, LENGTH_MM / 2], rel=2e-3)


def test_where_nothing_moves_what_begins_to_move_tells_the_place() -> None:
    """Of shapes x and 2 x, per 100 mm, a contact at 0 shows nothing, and moves on by the root of 5 over 100 a mm."""
    prior = Prior(
        Extent.of_beam((0.0, 100.0)), 100.0, (2.0, 20.0), SENSORS, 2, lambda place: place / 100 * np.array([1.0, 2.0])
    )
    found = cramer_rao_deviation_mm(prior, np.array([[0.0], [50.0]]), np.array([7.0, 7.0]))
    assert found[0, 0] == pytest.approx(100 * NOISE_MM / 7 / 5**0.5, rel=1e-6)
    assert found[1, 0] > 1e6  # elsewhere a change of the place looks like one of the force


def test_on_two_axes_the_bound_is_the_deviation_of_least_squares() -> None:
    """Three scales under a triangle of any shape: the inverse of J'J of place and force together."""
    corners, noise_mm = np.array([[0.0, 0.0], [90.0, 10.0], [30.0, 70.0]]), 0.01
    levers = np.linalg.inv(np.column_stack([corners, np.ones(3)]))  # of places (x, y, 1), the share of each corner

    def shares(place_mm: Floats) -> Floats:
        return np.column_stack([place_mm, np.ones(len(place_mm))]) @ levers

    prior = Prior(Extent(((20.0, 40.0), (15.0, 30.0))), 100.0, (2.0, 20.0), Errors(noise_mm), 3, shares)
    place_mm, force_n = np.array([[25.0, 20.0], [38.0, 16.0]]), np.array([4.0, 11.0])
    found = cramer_rao_deviation_mm(prior, place_mm, force_n)
    exact = cramer_rao_deviation_mm(dataclasses.replace(prior, force_n=(4.0, 4.0)), place_mm[:1], force_n[:1])
    for row, (place, force) in enumerate(zip(place_mm, force_n, strict=True)):
        jacobian = np.column_stack([force * levers[:2].T, shares(place[None])[0]])
        expected = noise_mm * np.sqrt(np.diag(np.linalg.inv(jacobian.T @ jacobian)))
        assert found[row] == pytest.approx(expected[:2], rel=1e-6)
    known = 4.0 * levers[:2].T
    assert exact[0] == pytest.approx(noise_mm * np.sqrt(np.diag(np.linalg.inv(known.T @ known))), rel=1e-6)
