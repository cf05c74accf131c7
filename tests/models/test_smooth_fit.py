"""Smooth functions through measured values, against the equations of a Gaussian process written out in full."""

import math
import tracemalloc
from itertools import product

import mpmath
import numpy as np
import pytest
from scipy import special, stats

from beamtouch_models.arrays import Floats
from beamtouch_models.design.physics import smooth_fit
from beamtouch_models.design.physics.smooth_fit import SmoothFit
from beamtouch_models.design.physics.smoothness import Measured, Smoothness, measured_together

SMOOTHNESS = Smoothness(kernel=2, scatter=0.1, additive=0.5, lengths=(0.4, 0.7))


@pytest.mark.parametrize("kernel", [0, 1, 2, 3])
@pytest.mark.parametrize("apart", [1e-6, 0.03, 1.0, 30.0])
def test_kernels_are_those_of_matern(kernel: int, apart: float) -> None:
    order = mpmath.mpf(1 + 2 * kernel) / 2
    scaled = mpmath.sqrt(2 * order) * apart / mpmath.mpf("0.4")
    wanted = 2 ** (1 - order) / mpmath.gamma(order) * scaled**order * mpmath.besselk(order, scaled)
    place = np.array([[0.0], [apart]])
    found = Smoothness(kernel, 0.1, 0.0, (0.4,)).covariance(place, place)[0, 1]
    assert math.isclose(found, float(wanted), rel_tol=1e-12)


def repeated_values() -> tuple[Measured, Floats]:
    """Return values of two columns on two axes, some of them at one place, and their full covariance."""
    rng = np.random.default_rng(5)
    place = rng.uniform(size=(5, 2))[[0, 1, 1, 2, 3, 4, 4, 4, 0, 2, 3]]
    weight = rng.uniform(1, 4, len(place))
    (measured,) = measured_together(place, rng.normal(size=(len(place), 2)), weight)
    noise = SMOOTHNESS.scatter**2 * (1 + SMOOTHNESS.additive * weight) / (1 + SMOOTHNESS.additive)
    return measured, SMOOTHNESS.covariance(place, place) + np.diag(noise)


def test_values_at_one_place_are_as_probable_as_all_of_them_apart() -> None:
    both, covariance = repeated_values()
    count, logs = len(covariance), np.linspace(-6, 6, 2001)
    # Of the integral, without what is the same for all combinations.
    constant = math.lgamma(count / 2) + (count / 2 - 1) * math.log(2) - count / 2 * math.log(2 * math.pi)
    density, alone = stats.multivariate_normal(np.zeros(count), covariance), 0.0
    for values in both.values.T:
        (measured,) = measured_together(both.place[both.place_of], values[:, None], both.weight)
        at_amplitude = density.logpdf(values * np.exp(-logs)[:, None]) - count * logs
        wanted = float(special.logsumexp(at_amplitude)) + math.log(logs[1] - logs[0]) - constant
        assert math.isclose(measured.process(SMOOTHNESS).log_probability, wanted, rel_tol=1e-9)
        alone += wanted
    # Of two columns, three values that are not correlated count beside the eleven.
    first, second = np.linalg.solve(np.linalg.cholesky(covariance), both.values).T
    correlation = first @ second / math.sqrt(first @ first * (second @ second)) * 11 / (11 + 3)
    wanted = alone - count / 2 * math.log(1 - correlation**2)
    assert math.isclose(both.process(SMOOTHNESS).log_probability, wanted, rel_tol=1e-9)
    assert math.isclose(both.process(SMOOTHNESS).correlation[0, 1], correlation, rel_tol=1e-9)


def test_a_value_is_left_out_as_if_it_had_not_been_measured() -> None:
    measured, covariance = repeated_values()
    square = measured.process(SMOOTHNESS).square
    for out in range(len(covariance)):
        others = np.delete(np.arange(len(covariance)), out)
        share = np.linalg.solve(covariance[np.ix_(others, others)], covariance[others, out])
        off = measured.values[out] - share @ measured.values[others]
        deviation = np.sqrt(square * (covariance[out, out] - share @ covariance[others, out]))
        assert np.allclose(measured.left_out(SMOOTHNESS)[out], off / deviation)


def string_values(loads: int) -> tuple[Floats, Floats]:
    """Return places (loads, 1), and what four sensors show of a string there, which scatters by 2 %."""
    place_mm, sensor_mm = np.linspace(10, 490, loads)[:, None], np.array([60.0, 180.0, 320.0, 440.0])
    values = np.minimum(place_mm * (500 - sensor_mm), sensor_mm * (500 - place_mm)) / 1e5
    return place_mm, values * (1 + 0.02 * np.random.default_rng(1).normal(size=values.shape))


@pytest.mark.parametrize("loads", [6, 40])
def test_the_search_finds_what_all_combinations_tell(loads: int) -> None:
    place_mm, values = string_values(loads)
    fit = SmoothFit.of(place_mm, values, np.ones(loads))
    logs = {
        one: fit.measured[0].process(one).log_probability
        for one in (
            Smoothness(kernel, float(scatter), 0.0, (float(length),))
            for kernel, scatter, length in product(range(1, 4), smooth_fit.SCATTERS, smooth_fit.LENGTHS)
        )
    }
    most = max(logs.values())
    probabilities = {one: math.exp(log - most) for one, log in logs.items()}
    total = sum(probabilities.values())
    for one, weight in zip(fit.combinations, fit.weights.tolist(), strict=True):
        assert abs(weight - probabilities[one] / total) < 1.5 / smooth_fit.DRAWS
    likely = {one for one, probability in probabilities.items() if probability / total > 1 / smooth_fit.DRAWS}
    assert likely <= set(fit.combinations)


def test_values_that_are_missing_leave_those_of_other_columns_in_place() -> None:
    place_mm, values = string_values(30)
    with_gaps = values.copy()
    with_gaps[[3, 17], 1] = np.nan
    between = np.linspace(20, 480, 47)[:, None]
    (mean, deviation), (gapped, gapped_deviation) = (
        SmoothFit.of(place_mm, table, np.ones(30)).at(between) for table in (values, with_gaps)
    )
    assert np.abs(gapped - mean).max() < 0.03 * values.max()
    hole = np.abs(between[:, 0] - place_mm[17, 0]).argmin()
    assert gapped_deviation[hole, 1] > 1.3 * deviation[hole, 1]
    assert gapped_deviation[hole, 0] < 1.1 * deviation[hole, 0]


def test_drawn_functions_lie_about_the_mean_as_the_deviation_says() -> None:
    place_mm, values = string_values(12)
    fit, between = SmoothFit.of(place_mm, values, np.ones(12)), np.linspace(0, 500, 41)[:, None]
    mean, deviation = fit.at(between)
    rng = np.random.default_rng(2)
    drawn = np.array([fit.draw(between, rng) for _ in range(400)])
    assert np.abs((drawn.mean(axis=0) - mean) / deviation).max() < 5 / math.sqrt(len(drawn))
    assert np.all(np.abs(drawn.std(axis=0) / deviation - 1) < 0.3)


def test_a_table_of_the_most_loads_takes_little_memory() -> None:
    place_mm, values = string_values(500)
    tracemalloc.start()
    SmoothFit.of(place_mm, values, np.ones(500)).at(np.linspace(0, 500, 200)[:, None])
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most < 40e6
