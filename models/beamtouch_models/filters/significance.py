"""Tests whether readings scatter more than their noise explains.

The deviations of the last readings from their mean are compared with quantiles of the chi-square distribution, in three
ways: by their sum of squares, which shows ringing; by the difference between the last 1, 2, 4, ... readings and the
rest, which shows a touch within the window; and by their slopes, which show a load that moves slowly. At rest each way
finds something in at most `FALSE` of the samples.

Once something has been found, less is enough to find it again: `LINGERS`. Ringing swings through readings that agree,
and a load that moves may pass a place where the deflection hardly changes.
"""

import math
from dataclasses import dataclass
from functools import lru_cache
from statistics import NormalDist
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beamtouch_models.filters.lags import LAGS, lags_of
from beamtouch_models.filters.means import FloatArray

FALSE = 0.001
"""Largest share of the samples at rest in which each of the three ways finds something."""
LINGERS = 0.015
"""As `FALSE`, in the samples after one in which something was found."""
LINEAR = 0.001
"""A slope counts if the scatter about it is below this quantile: a step is no slope."""
LONGER_SLOPES = (1, 2)
"""Lengths over which slopes are looked for, relative to the shortest. A slope over twice as many readings has an eighth
of the variance; but a way that is not straight shows in the shorter one."""


@lru_cache(maxsize=1024)
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
class Limits:
    """Limits of squares, by the number of working channels."""

    scatter: FloatArray
    """Of the sum of squares, shape (channels + 1,)."""
    contrasts: FloatArray
    """Of the slopes and of the differences, shape (channels + 1, contrasts)."""

    def passed(self, within: FloatArray, tested: FloatArray, working: NDArray[np.intp] | int) -> NDArray[np.bool_]:
        """Return whether a sum of squares (samples,) or of a contrast (samples, contrasts) is above its limit."""
        above: NDArray[np.bool_] = (tested > self.contrasts[working]).any(axis=1) | (within > self.scatter[working])
        return above


class Found(NamedTuple):
    """What the tests find in samples."""

    moves: NDArray[np.bool_]
    """Whether the readings move, shape (samples,)."""
    lingers: NDArray[np.bool_]
    """Whether they still move, if they moved before, shape (samples,)."""
    squares: FloatArray
    """Sums of squares about the mean, in units of the noise, shape (samples,)."""
    slopes: FloatArray
    """The most significant slope per reading, in units of the noise, shape (samples, channels); 0 if none counts."""
    lags: FloatArray
    """Distance of the newest readings from the mean that noise does not explain, in units of the noise, shape
    (samples, channels); 0 if noise explains it."""


@dataclass(frozen=True)
class Look:
    """Contrasts between the last readings, and the limits of their squares."""

    contrasts: FloatArray
    """Shape (contrasts, rows), newest row last: the mean of the readings that are compared, the means for each slope,
    the slopes, then the differences, then the newest readings that a longer mean is compared with. Each has unit
    length."""
    members: FloatArray
    """Shape (1 + slopes, rows): 1 for the rows that are compared, and for those in each slope."""
    slope_lengths: FloatArray
    """Length of each slope's contrast before it was scaled, shape (slopes,)."""
    surely: Limits
    lingering: Limits
    linear: FloatArray
    """Limits of the scatter about each slope, shape (channels + 1, slopes)."""
    newest: FloatArray
    """Limit of the square of the newest deviation, shape (channels + 1,)."""
    numbers: FloatArray
    """Numbers of newest readings that a longer mean is compared with, shape (numbers,)."""
    lagging: FloatArray
    """Squares of their distance that noise explains, shape (channels + 1,)."""

    def find(
        self,
        deviations: FloatArray,
        working: NDArray[np.intp] | int,
        variance: FloatArray,
        seen: NDArray[np.bool_] | None = None,
        *,
        moved: bool,
    ) -> Found:
        """Return what the tests find.

        Parameters
        ----------
        deviations
            Deviations from any constant, in units of the noise, shape (samples, rows, channels); 0 if missing.
        working
            Number of working channels, shape (samples,), or the same for all.
        variance
            Relative variance of the mean's noise, shape (samples,).
        seen
            Which rows hold a reading, shape (samples, rows); None: all.
        moved
            Whether something was found before these samples. If not, nothing lingers before anything moves.
        """
        slopes = len(self.slope_lengths)
        projected = self.contrasts @ deviations
        squares = (projected * projected).sum(axis=2)
        total = (self.members @ (deviations * deviations)).sum(axis=2)
        within: FloatArray = total[:, 0] - squares[:, 0]
        first = squares.shape[1] - len(self.numbers)
        tested = squares[:, 1 + slopes : first]
        about = total[:, 1:] - squares[:, 1 : 1 + slopes] - tested[:, :slopes]
        tested[:, :slopes] *= about < self.linear[working]
        moves = self.surely.passed(within, tested, working)
        newest, far, numbers = projected[:, first:], squares[:, first:], self.numbers[np.newaxis]
        if seen is not None:
            there = np.maximum(seen[:, ::-1].cumsum(axis=1)[:, self.numbers.astype(np.intp) - 1], 1)
            share, numbers = there / numbers, there.astype(np.float64)
            newest, far = newest / np.sqrt(share)[:, :, np.newaxis], far / share
        lags = lags_of(newest, far, numbers, self.lagging[working], variance)
        if not moved and not moves.any():
            return Found(moves, moves, within, np.zeros_like(projected[:, 0]), lags)
        best, at = tested[:, :slopes].argmax(axis=1), np.arange(len(tested))
        counts = tested[at, best] > self.lingering.contrasts[working, 0]
        slope = projected[at, 1 + slopes + best] * (counts / self.slope_lengths[best])[:, np.newaxis]
        return Found(moves, self.lingering.passed(within, tested, working), within, slope, lags)


@lru_cache(maxsize=256)
def look_at(readings: int, for_slope: int, rows: int, channels: int, first: int | None = None) -> Look:
    """Return the contrasts between the last `readings`, and the slopes of the last `for_slope` and more, of `rows`.

    A longer mean is compared with the newest `first`, 2 `first`, 4 `first`, ... readings; None: with none.
    """
    ages = np.arange(rows)[::-1]
    lengths = [times * for_slope for times in LONGER_SLOPES]
    centred = np.array([np.where(ages < length, (length - 1) / 2 - ages, 0.0) for length in lengths])
    norms = np.maximum(np.linalg.norm(centred, axis=1), np.finfo(np.float64).tiny)
    news = [2**power for power in range(readings.bit_length()) if 2**power < readings]
    differences = [
        np.where(ages < new, readings - new, np.where(ages < readings, -new, 0.0))
        / math.sqrt(new * (readings - new) * readings)
        for new in news
    ]
    numbers = (
        [] if first is None else [first * 2**power for power in range(rows.bit_length()) if first * 2**power <= rows]
    )
    newest = [np.where(ages < number, 1 / math.sqrt(number), 0.0) for number in numbers]
    members = np.array([ages < number for number in (readings, *lengths)], dtype=np.float64)
    means = members / np.sqrt([[readings], *([length] for length in lengths)])
    working = range(channels + 1)

    def limits(freedom: int, beyond: float) -> FloatArray:
        return np.array([chi_square_quantile(number * freedom, beyond) for number in working])

    def level(beyond: float) -> Limits:
        slope = limits(int(for_slope > 3), beyond / len(lengths))
        difference = limits(1, beyond / max(1, len(news)))
        each = [*[slope] * len(lengths), *[difference] * len(news)]
        return Limits(limits(readings - 1, beyond), np.stack(each, axis=1))

    return Look(
        contrasts=np.concatenate(
            [means, centred / norms[:, np.newaxis], np.reshape([*differences, *newest], (-1, rows))]
        ),
        members=members,
        slope_lengths=norms,
        surely=level(FALSE),
        lingering=level(LINGERS),
        linear=np.stack([limits(length - 2, LINEAR) for length in lengths], axis=1),
        newest=limits(1, FALSE),
        numbers=np.array(numbers, dtype=np.float64),
        lagging=limits(1, LAGS),
    )
