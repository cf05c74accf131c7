"""Tests whether readings scatter more than their noise explains.

The deviations of the last readings from their mean are compared with quantiles of the chi-square distribution, in three
ways: by their sum of squares, which shows ringing; by the difference between the last 1, 2, 4, ... readings and the
rest, which shows a touch within the window; and by their slope, which shows a load that moves slowly. At rest each way
finds something in at most `FALSE` of the samples.
"""

import math
from dataclasses import dataclass
from functools import lru_cache
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

from beamtouch_models.filters.means import FloatArray

FALSE = 0.002
LINEAR = 0.001
"""A slope counts if the scatter about it is below this quantile: a step is no slope."""


def chi_square_quantile(freedom: int, beyond: float) -> float:
    """Return the value that a chi-square variable exceeds with probability `beyond`; inf without degrees of freedom.

    Wilson and Hilferty's approximation (1931). It is within 3 % for two degrees of freedom and more.
    """
    if freedom < 1:
        return math.inf
    spread = 2 / (9 * freedom)
    deviations = -NormalDist().inv_cdf(beyond)
    return freedom * (1 - spread + deviations * math.sqrt(spread)) ** 3


@dataclass(frozen=True)
class Look:
    """Contrasts between the last readings, and the limits of their squares."""

    readings: int
    """Number of readings that are compared."""
    for_slope: int
    """Number of readings in the slope."""
    contrasts: FloatArray
    """Shape (contrasts, rows), newest row last: mean of `readings`, mean of `for_slope`, slope, then the differences.
    Each has unit length."""
    members: FloatArray
    """Shape (2, rows): 1 for the rows in `readings`, and in `for_slope`."""
    scatter_limit: FloatArray
    linear_limit: FloatArray
    """Limits, shape (channels + 1,), by the number of working channels."""
    newest_limit: FloatArray
    """Limit of the square of the newest deviation, shape (channels + 1,)."""
    contrast_limits: FloatArray
    """Limits of the slope and of the differences, shape (channels + 1, contrasts - 2)."""

    def scatter(self, deviations: FloatArray, working: NDArray[np.intp] | int) -> tuple[NDArray[np.bool_], FloatArray]:
        """Return whether the readings move, and their sum of squares about their mean, each of shape (samples,).

        Parameters
        ----------
        deviations
            Deviations from any constant, in units of the noise, shape (samples, rows, channels); 0 if missing.
        working
            Number of working channels, shape (samples,), or the same for all.
        """
        squares = ((self.contrasts @ deviations) ** 2).sum(axis=2)
        total = (self.members @ (deviations * deviations)).sum(axis=2)
        within: FloatArray = total[:, 0] - squares[:, 0]
        beyond = squares[:, 2:] > self.contrast_limits[working]
        if beyond[:, 0].any():
            beyond[:, 0] &= total[:, 1] - squares[:, 1] - squares[:, 2] < self.linear_limit[working]
        return beyond.any(axis=1) | (within > self.scatter_limit[working]), within


@lru_cache(maxsize=256)
def look_at(readings: int, for_slope: int, rows: int, channels: int) -> Look:
    """Return the contrasts between the last `readings` and the slope of the last `for_slope`, out of `rows` rows."""
    ages = np.arange(rows)[::-1]
    members = np.stack([ages < readings, ages < for_slope], axis=1).astype(np.float64)
    centred = np.where(ages < for_slope, ages - (for_slope - 1) / 2, 0.0)
    slope = centred / (np.linalg.norm(centred) or 1.0)
    news = [2**power for power in range(readings.bit_length()) if 2**power < readings]
    differences = [
        np.where(ages < new, readings - new, np.where(ages < readings, -new, 0.0))
        / math.sqrt(new * (readings - new) * readings)
        for new in news
    ]
    contrasts = np.stack(
        [members[:, 0] / math.sqrt(readings), members[:, 1] / math.sqrt(for_slope), slope, *differences]
    )
    working = range(channels + 1)
    has_slope = for_slope > 3

    def limits(freedom: int, beyond: float) -> FloatArray:
        return np.array([chi_square_quantile(number * freedom, beyond) for number in working])

    slope_limit, difference_limit = limits(int(has_slope), FALSE), limits(1, FALSE / max(1, len(news)))
    return Look(
        readings,
        for_slope,
        contrasts,
        np.ascontiguousarray(members.T),
        scatter_limit=limits(readings - 1, FALSE),
        linear_limit=limits(for_slope - 2, LINEAR),
        newest_limit=limits(1, FALSE),
        contrast_limits=np.stack([slope_limit, *[difference_limit] * len(news)], axis=1),
    )
