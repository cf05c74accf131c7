"""Means, ratios and quantiles of simulated contacts with their standard errors, by hand and against their scatter."""

import numpy as np
import pytest

from beamtouch_models.design.accuracy.statistics import Measurement, mean_of, quantile_of, ratio_of

ALTERNATELY = np.tile([9.0, 9.0, 9.0, 11.0, 11.0, 11.0], 8)
"""Sixteen parts of three values, of 9 and of 11 in turn: the scatter of a mean of sixteen is the root of 1/15."""


def test_a_measurement_has_three_digits_and_its_error_one_in_any_unit() -> None:
    measured = Measurement(2.8123, 0.0345)
    assert str(measured) == repr(measured) == "2.81 +- 0.03"
    scaled = measured.scaled(100)
    assert (scaled.value, scaled.standard_error) == pytest.approx((281.23, 3.45))


def test_the_error_of_a_mean_is_the_scatter_of_its_sixteen_parts() -> None:
    mean = mean_of(ALTERNATELY)
    assert (mean.value, mean.standard_error) == pytest.approx((10.0, 15**-0.5))
    half = ratio_of(ALTERNATELY, np.full(48, -20.0))
    assert (half.value, half.standard_error) == pytest.approx((-0.5, 15**-0.5 / 20))


def test_a_ratio_to_itself_is_exact_and_to_a_multiple_nearly() -> None:
    assert (ratio_of(3 * ALTERNATELY, ALTERNATELY).value, ratio_of(3 * ALTERNATELY, ALTERNATELY).standard_error) == (
        3,
        0,
    )
    noise = np.random.default_rng(1).normal(size=48)
    assert ratio_of(3 * ALTERNATELY + 0.01 * noise, ALTERNATELY).standard_error < 1e-3


def test_weights_count_as_many_draws_of_a_value_do() -> None:
    rng = np.random.default_rng(2)
    values, often = rng.normal(5.0, 2.0, (64, 3)), rng.integers(1, 5, (64, 3)).astype(float)
    every = np.repeat(values.ravel(), often.ravel().astype(int))
    assert mean_of(values, often).value == pytest.approx(every.mean())
    assert quantile_of(values, 0.8, often).value == pytest.approx(np.quantile(every, 0.8, method="inverted_cdf"))
    assert mean_of(values).value == pytest.approx(values.mean())


def test_the_error_of_a_quantile_is_the_scatter_of_those_of_its_sixteen_parts() -> None:
    parts = np.array([[0.0, 1.0, 2.0, 3.0, 99.0], [4.0, 5.0, 6.0, 7.0, -99.0]])
    quantile = quantile_of(np.tile(parts.ravel(), 8), 0.61)  # of each part, the fourth of five: 3 and 6
    assert quantile.standard_error == pytest.approx(1.5 * 15**-0.5)
    assert quantile.value == 5.0  # of all eighty, the 49th


@pytest.mark.parametrize("level", [None, 0.7])
def test_errors_are_those_that_repeated_draws_show(level: float | None) -> None:
    rng = np.random.default_rng(3)
    measured = []
    for _ in range(120):
        values, weight = rng.gamma(2.0, size=(64, 2)), rng.uniform(0.5, 1.5, size=(64, 2))
        measured.append(mean_of(values, weight) if level is None else quantile_of(values, level, weight))
    scatter = np.std([each.value for each in measured])
    assert np.mean([each.standard_error for each in measured]) == pytest.approx(scatter, rel=0.2)
