"""A touch, as the growing mean and the covariance see it: one rule for both."""

import numpy as np
import pytest

from beamtouch_models.filters import FloatArray
from beamtouch_models.filters.significance import chi_square_quantile
from beamtouch_models.filters.splits import Sums
from beamtouch_models.filters.touches import (
    SHARP,
    calm_limit,
    calm_readings,
    calm_since_touch,
    follow_touch,
    still_readings,
)

CHANNELS = 3
STILL, CALM = still_readings(40.0), calm_readings(40.0)
ROWS = 50


def sees(values: FloatArray, since: int) -> tuple[bool, bool]:
    """Whether the growing mean, and the covariance, see a touch before the last readings, in units of the noise."""
    there = ~np.isnan(values)
    counted = np.stack([np.where(there, values, 0.0), there.astype(np.float64)], axis=1)
    rows = np.concatenate([np.zeros((1, 2, CHANNELS)), np.cumsum(counted, axis=0)])
    sums, sizes = Sums(rows[:-1], rows[-1:], np.array([len(values)])), np.array([since])
    limits = chi_square_quantile(CHANNELS, SHARP), calm_limit(CALM, CHANNELS)
    mean = follow_touch(sums, sizes, CALM, *limits)
    return bool(mean[0]), bool(calm_since_touch(values[np.newaxis], sizes, STILL, CALM)[0])


def touched(by: float, since: int, *, swing: float = 0.0) -> FloatArray:
    """A beam that swings or lies still, and then a step; all in units of the noise, without noise."""
    values = np.repeat(swing * np.sin(np.arange(ROWS) / 3)[:, np.newaxis], CHANNELS, axis=1)
    values[-since:] = values[-since - 1] + by
    return values


@pytest.mark.parametrize("since", [2, 3, STILL - 1])
def test_both_see_a_sharp_step_of_a_beam_that_lay_still(since: int) -> None:
    assert sees(touched(20.0, since), since) == (True, True)


@pytest.mark.parametrize("since", [2, 3, STILL - 1])
def test_neither_sees_a_touch_in_noise_or_while_the_beam_swings(since: int) -> None:
    assert sees(touched(2.0, since), since) == (False, False)
    assert sees(touched(20.0, since, swing=10.0), since) == (False, False)


def test_neither_sees_a_touch_in_a_single_reading_or_where_one_before_it_is_missing() -> None:
    assert sees(touched(20.0, 1), 1) == (False, False)
    values = touched(20.0, 3)
    values[-6, 1] = np.nan
    assert sees(values, 3) == (False, False)


def test_the_first_reading_decides_for_the_mean_and_all_of_them_for_the_covariance() -> None:
    values = touched(20.0, 4)
    values[-1] += 15.0
    assert sees(values, 4) == (True, False)
