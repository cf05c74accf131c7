"""The influence between its nodes, what sensors measure, stated forces and what loads leave, beside plain algebra."""

import math

import numpy as np
import pytest

from beamtouch_models.arrays import Floats
from beamtouch_models.places import grid_of
from beamtouch_models.runtime.curve import Curve, InfluenceCurve
from beamtouch_models.runtime.departures import Departures
from beamtouch_models.runtime.error_model import Errors, floor_mm2
from beamtouch_models.runtime.force_range import ANY_FORCE, ForceRange
from beamtouch_models.runtime.health.residuals import UNKNOWN, LoadErrors, Residuals, leave_out

TICKS = (np.linspace(-3.0, 11.0, 8), np.linspace(2.0, 5.0, 5))
"""Of unequal number and steps."""
CUBICS = np.random.default_rng(1).normal(size=(3, 4, 4))
"""Coefficients of x^i y^j for each of three channels."""


def cubic(place: Floats, along: tuple[int, int] = (0, 0)) -> Floats:
    """Return the value of cubics, or their derivative along an axis, at places (contacts, 2)."""
    powers = np.arange(4)
    x, y = (
        np.where(powers >= order, (powers if order else 1) * column[:, None] ** np.maximum(powers - order, 0), 0.0)
        for column, order in zip(place.T, along, strict=True)
    )
    values: Floats = np.einsum("ni,cij,nj->nc", x, CUBICS, y)
    return values


def test_between_its_nodes_a_cubic_is_itself_with_its_slopes_along_both_axes() -> None:
    curve = Curve(TICKS, cubic(grid_of(list(TICKS))))
    place = np.random.default_rng(2).uniform([-3.0, 2.0], [11.0, 5.0], (40, 2))
    place[:4] = [[-3.0, 2.0], [11.0, 5.0], [11.0, 2.0], [1.0, 3.5]]
    shape, slope = curve.at(place)
    assert shape == pytest.approx(cubic(place), rel=1e-9)
    assert slope[:, :, 0] == pytest.approx(cubic(place, (1, 0)), rel=1e-8, abs=1e-8)
    assert slope[:, :, 1] == pytest.approx(cubic(place, (0, 1)), rel=1e-8, abs=1e-8)


DEPARTURES = Departures(
    position_offset_mm=[0.5, -0.7, 2.0], gain=[1.1, 0.9, 1.05], offset_mm=[0.2, -0.1, 0.4], curve_per_mm=0.03
)


def test_a_bent_characteristic_gives_back_what_it_was_given() -> None:
    linear_mm = np.array([[0.0, 1.5, -2.0], [4.0, -7.0, 0.3]])
    measured = DEPARTURES.measure(linear_mm)
    bent = measured - np.array([0.2, -0.1, 0.4])
    assert bent + 0.03 * bent**2 == pytest.approx(linear_mm)
    assert DEPARTURES.straighten(bent) == pytest.approx(linear_mm)
    assert DEPARTURES.linear_mm(measured) == pytest.approx(linear_mm)
    step = 1e-6
    difference = (DEPARTURES.measure(linear_mm + step) - DEPARTURES.measure(linear_mm - step)) / (2 * step)
    assert DEPARTURES.slope(linear_mm) == pytest.approx(difference, rel=1e-7)
    # Where the characteristic turns, and beyond, deflections are numbers still.
    turning = np.full(3, -1 / 0.12)
    assert DEPARTURES.measure(turning) == pytest.approx(2 * turning + np.array([0.2, -0.1, 0.4]))
    assert np.isfinite([DEPARTURES.measure(2 * turning), DEPARTURES.slope(2 * turning)]).all()


def test_sensors_stand_where_their_offsets_put_them_but_on_the_structure() -> None:
    assert DEPARTURES.sensors_mm(np.array([50.0, 0.3, 99.0]), (100.0,)) == pytest.approx([50.5, 0.0, 100.0])
    layout_mm = np.array([[50.0, 20.0], [0.3, 29.0], [99.0, 1.0]])
    assert DEPARTURES.sensors_mm(layout_mm, (100.0, 30.0)) is layout_mm
    across = DEPARTURES.model_copy(update={"across_offset_mm": [-3.0, 4.0, -2.0]})
    expected = np.array([[50.5, 17.0], [0.0, 30.0], [100.0, 0.0]])
    assert across.sensors_mm(layout_mm, (100.0, 30.0)) == pytest.approx(expected)
    nothing = Departures.none(2)
    assert (nothing.position_offset_mm, nothing.gain, nothing.offset_mm) == ([0.0, 0.0], [1.0, 1.0], [0.0, 0.0])
    assert (nothing.curve_per_mm, nothing.fixity, nothing.rigidity) == (0.0, (0.0, 0.0), 1.0)


def curve_of_loads() -> InfluenceCurve:
    return InfluenceCurve(TICKS, 1e-4 * cubic(grid_of(list(TICKS))), DEPARTURES)


def test_what_loads_move_is_the_derivative_of_what_is_measured() -> None:
    curve, place, force = curve_of_loads(), np.array([[1.3, 2.7], [8.2, 4.4]]), np.array([3.0, 1.7])
    assert curve.measured_mm(place, force) == pytest.approx(DEPARTURES.measure(force[:, None] * 1e-4 * cubic(place)))
    moved = curve.moved_mm(place, force)
    for axis in range(2):
        step = 1e-5 * np.eye(2)[axis]
        difference = curve.measured_mm(place + step, force) - curve.measured_mm(place - step, force)
        assert moved[axis] == pytest.approx(difference / 2e-5, rel=1e-6)
    difference = curve.measured_mm(place, force * (1 + 1e-5)) - curve.measured_mm(place, force * (1 - 1e-5))
    assert moved[2] == pytest.approx(difference / 2e-5, rel=1e-6)


def loads(seed: int = 3) -> Residuals:
    random = np.random.default_rng(seed)
    there = np.array([[True] * 5, [True, True, False, True, True]])
    return Residuals(
        random.normal(size=(2, 5)) * there,
        random.uniform(0.5, 2.0, (2, 5)),
        random.normal(size=(3, 2, 5)) * there,
        there,
    )


def test_the_misfit_of_loads_is_that_of_their_covariance_and_takes_out_what_is_not_known() -> None:
    of, errors = loads(), LoadErrors(placing_mm=0.7, force=0.3, residual_mm=0.4)
    wide = np.random.default_rng(4).normal(size=(2, 5, 2)) * of.is_measured[..., None]
    departures = np.array([[0.5, 0.1], [0.1, 0.9]])
    for load, there in enumerate(of.is_measured):
        moved, left = of.moved_mm[:, load, there], of.left_mm[load, there]
        noise = np.diag(of.noise_mm[load, there] ** 2 + 0.4**2)
        total = noise + moved.T @ np.diag([0.49, 0.49, 0.09]) @ moved
        assert of.covariance_mm2(errors)[load][np.ix_(there, there)] == pytest.approx(total)
        assert of.misfit(errors)[load] == pytest.approx(left @ np.linalg.solve(total, left))
        slopes = wide[load, there]
        by_all = left @ np.linalg.solve(total + slopes @ departures @ slopes.T, left)
        assert of.misfit(errors, wide, departures)[load] == pytest.approx(by_all)
        assert of.misfit(errors, wide)[load] == pytest.approx(left @ np.linalg.solve(total, left))
        # Least squares over the places and the force.
        root = 1 / of.noise_mm[load, there]
        (square,) = np.linalg.lstsq((moved * root).T, left * root)[1]
        assert of.misfit(UNKNOWN)[load] == pytest.approx(square)
    assert of.covariance_mm2(errors)[1, 2].tolist() == [0.0, 0.0, 1.0, 0.0, 0.0]
    assert errors.at_least(LoadErrors(0.5, 0.6)) == LoadErrors(0.7, 0.6, 0.4)


def test_loads_are_off_by_what_was_measured_less_what_is_predicted() -> None:
    curve, place, force = curve_of_loads(), np.array([[1.3, 2.7], [8.2, 4.4]]), np.array([3.0, 1.7])
    measured = curve.measured_mm(place, force) + np.array([[0.1, -0.2, math.nan], [0.3, 0.0, 0.5]])
    of = Residuals.of(curve, place, force, measured, np.full((2, 3), 0.1))
    assert of.left_mm == pytest.approx(np.array([[0.1, -0.2, 0.0], [0.3, 0.0, 0.5]]))
    assert of.is_measured.tolist() == [[True, True, False], [True, True, True]]
    assert of.moved_mm[:, 0, 2].tolist() == [0.0, 0.0, 0.0]
    assert of.moved_mm[:, 1] == pytest.approx(curve.moved_mm(place, force)[:, 1])


def test_what_a_fit_without_a_load_leaves_of_it_is_known_from_the_fit_to_all() -> None:
    random = np.random.default_rng(6)
    slopes, values = random.normal(size=(4, 3, 2)), random.normal(size=(4, 3))
    flat = slopes.reshape(12, 2)
    covariance = np.linalg.inv(flat.T @ flat).astype(np.float64)
    left = values - slopes @ (covariance @ flat.T @ values.ravel())
    for load in range(4):
        others = np.arange(4) != load
        fitted = np.linalg.lstsq(slopes[others].reshape(9, 2), values[others].ravel())[0]
        expected = values[load] - slopes[load] @ fitted
        assert leave_out(left, slopes, covariance)[load] == pytest.approx(expected)


def test_the_variance_of_a_channel_is_that_of_noise_zero_gain_and_mounting() -> None:
    errors = Errors(0.3, gain=[0.1, 0.02], zero_mm=[0.4, 0.5])
    assert floor_mm2([3.0, -5.0], [0.1, 0.02], [0.4, 0.5]) == pytest.approx([0.09 + 0.16, 0.01 + 0.25])
    assert errors.variance_mm2(np.array([3.0, -5.0])) == pytest.approx([0.34, 0.35])
    assert errors.deviation_mm(np.array([3.0, -5.0])) == pytest.approx([0.34**0.5, 0.35**0.5])
    assert errors.deviation_mm(np.array([3.0, -5.0]), 0.15) == pytest.approx([0.7, 0.5**0.5])
    whitening = errors.whitening(np.array([[3.0, -5.0]]))
    assert whitening[0] == pytest.approx(np.diag([0.34**-0.5, 0.35**-0.5]))
    taken = errors.take(np.array([1]), 2)
    assert (taken.noise_mm, taken.gain, taken.zero_mm) == (0.3, [0.02], [0.5])
    alone = Errors(0.3)
    assert (alone.gain, alone.zero_mm, alone.mounting_mm) == (0.0, 0.0, 0.0)
    assert [part.tolist() for part in Errors(0.3, 0.1, 0.4).of_channels(3)] == [[0.1] * 3, [0.4] * 3]


@pytest.mark.parametrize(("low_n", "high_n"), [(9.0, 11.0), (7.0, 9.5), (30.0, 42.0)])
def test_a_stated_range_pulls_a_force_as_a_spring_between_it_and_its_nearest_end(low_n: float, high_n: float) -> None:
    stated, middle, half = ForceRange(low_n, high_n), (low_n + high_n) / 2, (high_n - low_n) / 2
    closed = 1 - (3 * half / middle) ** 2
    assert (stated.middle_n, stated.half_n, stated.openness) == pytest.approx((middle, half, 1 - closed))
    penalty = closed / (half / 3) ** 2
    assert stated.penalty_per_n2 == pytest.approx(penalty)
    assert stated.precision_per_n2 == pytest.approx(closed / (half**2 / 3))
    assert stated.relative_error == pytest.approx((half**2 / 3 / closed) ** 0.5 / middle)
    assert stated.checked == pytest.approx(penalty * middle**2 / (penalty * middle**2 + 36))
    shown, precision = np.array([low_n - 3, middle, high_n + 5]), np.array([0.2, 0.7, 1.3])
    assert stated.beyond(shown).tolist() == [-3.0, 0.0, 5.0]
    assert stated.misfit(shown) == pytest.approx([9 * penalty, 0.0, 25 * penalty])
    likeliest = stated.likeliest(shown, precision)
    for force_n, own_n, own in zip(likeliest, shown, precision, strict=True):
        around = force_n + np.linspace(-0.5, 0.5, 11)
        cost = own * (around - own_n) ** 2 + stated.misfit(around)
        assert cost.argmin() == 5
    assert not stated.is_open


def test_of_a_wide_range_nothing_follows_and_an_exact_force_is_as_good_as_certain() -> None:
    for wide in (ANY_FORCE, ForceRange(1.0, 2.0), ForceRange(1.0, 50.0)):
        assert wide.is_open
        assert (wide.openness, wide.penalty_per_n2, wide.precision_per_n2, wide.checked) == (1.0, 0.0, 0.0, 0.0)
        assert wide.relative_error == math.inf
        assert wide.likeliest(np.array([99.0]), np.array([1e-3])).tolist() == [99.0]
    assert not ForceRange(1.0, 1.99).is_open
    exact = ForceRange(5.0, 5.0)
    assert exact.checked == 1.0
    assert exact.relative_error < 1e-11
    assert exact.likeliest(np.array([99.0]), np.array([1.0])) == pytest.approx([5.0])
