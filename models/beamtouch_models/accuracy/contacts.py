"""Simulated contacts for measuring estimators, each with the other contacts that could have caused its reading.

The mean error over contacts and noise equals the mean over readings of the mean over each reading's posterior. The
second form has less scatter (Rao-Blackwell), and estimator and accuracy limit share what scatter is left.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beamtouch_models.accuracy.limit import Draws, draw_evenly
from beamtouch_models.accuracy.posterior import CHUNK, posterior_quantiles
from beamtouch_models.accuracy.prior import Prior
from beamtouch_models.accuracy.statistics import Measurement, mean_of, ratio_of
from beamtouch_models.arrays import Bools, Floats
from beamtouch_models.progress import Fraction, silent
from beamtouch_models.sweeps import Spread, in_turn

LIKELY = 16
"""Number of positions that represent a posterior, with equal probability each."""
CERTAIN, MORE = 0.01, 4
"""Relative standard error of a limit above which MORE times as many contacts are drawn."""
REPORTS = 20
"""Number of progress reports."""


@dataclass(frozen=True)
class Reached:
    """The mean error of estimates beside its limit, in mm, on the same contacts."""

    error_mm: Measurement
    limit_mm: Measurement
    ratio: Measurement


@dataclass(frozen=True)
class Contacts:
    """Contacts and their readings, evenly spread, in the parts that `statistics` expects."""

    drawn: Draws
    likely_mm: Floats
    """(draws, LIKELY) positions that could have caused each reading; (draws, 1), the true one, without noise."""
    median_mm: Floats | None
    """Posterior medians (draws,); None without noise, where there is no posterior."""
    deviation_mm: Floats | None
    """Mean distance of each posterior from its median (draws,)."""

    def error_mm(self, estimate_mm: NDArray[np.floating]) -> Floats:
        """|error| of estimates (draws,) for each likely position, in the shape of `likely_mm`."""
        return np.abs(estimate_mm.astype(np.float64)[:, None] - self.likely_mm)

    def least_error_mm(self) -> Floats | None:
        """|error| of the posterior median, whose mean is the accuracy limit; None without noise."""
        return None if self.median_mm is None else self.error_mm(self.median_mm)

    def mean_error_mm(self, estimate_mm: NDArray[np.floating]) -> Floats:
        """Mean |error| of each estimate (draws,) over the posterior of its reading.

        The value for the median is exact; the likely positions only give the difference of the estimate from it.
        """
        error, best = self.error_mm(estimate_mm), self.least_error_mm()
        if best is None or self.deviation_mm is None:
            return error[:, 0]
        worse: Floats = (error - best).mean(axis=1)
        return self.deviation_mm + worse

    def reached(self, estimate_mm: NDArray[np.floating]) -> Reached | None:
        """Return the mean |error| of estimates (draws,) beside its limit; None without noise."""
        if self.deviation_mm is None:
            return None
        error, limit, weight = self.mean_error_mm(estimate_mm), self.deviation_mm, self.drawn.weight
        return Reached(mean_of(error, weight), mean_of(limit, weight), ratio_of(error * weight, limit * weight))

    def held(self, low_mm: NDArray[np.floating], high_mm: NDArray[np.floating]) -> Bools:
        """Return whether intervals (draws,) hold each likely position, in the shape of `likely_mm`."""
        return (low_mm[:, None] <= self.likely_mm) & (self.likely_mm <= high_mm[:, None])


def simulated(prior: Prior, count: int, seed: int, progress: Fraction = silent, spread: Spread = in_turn) -> Contacts:
    """Draw at least `count` contacts of a prior, evenly, with the likely positions of their readings.

    The readings are tasks for `spread`, a part each.
    """
    drawn = draw_evenly(prior, count, seed)
    if prior.noise_mm == 0:
        return Contacts(drawn, drawn.position_mm[:, None], None, None)
    # With a random shift, averages over the likely positions are unbiased.
    shift = np.random.default_rng([seed, LIKELY]).uniform(size=(len(drawn.position_mm), 1))
    levels = np.column_stack([np.full(len(shift), 0.5), (np.arange(LIKELY) + shift) / LIKELY])
    found = []
    length = CHUNK * max(1, -(-len(shift) // (CHUNK * REPORTS)))
    parts = [slice(start, start + length) for start in range(0, len(shift), length)]
    for quantiles in spread(_quantiles, [(prior, drawn.deflection_mm[part], levels[part]) for part in parts]):
        found.append(quantiles)
        progress(len(found) / len(parts))
    whole = np.concatenate(found)
    return Contacts(drawn, whole[:, 1:-1], whole[:, 0], whole[:, -1])


def _quantiles(task: tuple[Prior, Floats, Floats]) -> Floats:
    """Return quantiles (readings, levels) of the posteriors of readings, with the mean distances as the last column."""
    prior, deflection_mm, levels = task
    return np.column_stack(posterior_quantiles(prior, deflection_mm, levels))


def simulated_enough(prior: Prior, count: int, seed: int) -> Contacts:
    """Like `simulated`, with MORE times the contacts if the accuracy limit would be uncertain otherwise."""
    contacts = simulated(prior, count, seed)
    if contacts.deviation_mm is None:
        return contacts
    reached = mean_of(contacts.deviation_mm, contacts.drawn.weight)
    certain = reached.standard_error <= CERTAIN * reached.value
    return contacts if certain else simulated(prior, MORE * count, seed)
