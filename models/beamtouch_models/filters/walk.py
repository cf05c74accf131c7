"""How zeros walk, as it is stated, and what is known of them: the words of `zeros`, the daemon and the challenge."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from beamtouch_models.filters.readings import FloatArray

PERSISTS_S = 10.0
"""A drift has the same direction for about this time. Then a zero is off by rate x time; before, by the square root of
both times rate, so that a filter which knows no slope follows without a lag beyond its own uncertainty."""
OWN = 0.5
"""Drift of a channel by itself, over that of all channels together."""
ANYWHERE = 3**-0.5
"""Standard deviation of a zero that may be anywhere within the limit, over that limit."""
LITTLE = 0.02
"""Variance of a zero that is not stated, over that of the noise of a mean."""
MINUTE_S = 60.0


@dataclass(frozen=True)
class Walk:
    """The drift of zeros, as it is stated."""

    rate_mm_per_min: float
    """Standard deviation of the rate of all channels together."""
    max_mm: float
    """Largest distance from the last tare that is taken for drift."""
    start_mm: float
    """Standard deviation of a zero since the last tare, when nothing else is known."""

    def grown_mm(self, seconds: float | FloatArray) -> FloatArray:
        """Return the standard deviation of the common drift in a time since the last rest."""
        drift = self.rate_mm_per_min / MINUTE_S * np.sqrt(seconds * np.maximum(seconds, PERSISTS_S))
        grown: FloatArray = np.minimum(drift, ANYWHERE * self.max_mm)
        return grown


@dataclass(frozen=True)
class Rested:
    """The last rest before the first reading; by default a tare just now."""

    ago_s: float = 0.0
    """Time from it to the first reading; infinite if it is not known."""
    zero_mm: tuple[float, ...] | None = None
    """The zeros, from the last tare; None: they are those of the tare."""
    deviation_mm: tuple[float, ...] | None = None
    """Their standard deviations at that rest; None: what is allowed for after a tare."""


TARED = Rested()


class Tracked(NamedTuple):
    """Zeros at each reading, from earlier readings only."""

    zero_mm: FloatArray
    """Shape (readings, channels)."""
    common_mm: FloatArray
    """Standard deviation of what moved all zeros together since the last rest, shape (readings,)."""
    own_mm: FloatArray
    """Standard deviation of each zero by itself, shape (readings, channels)."""


def beyond_start(tracked: Tracked, walk: Walk, mean_mm: FloatArray, variance_mm2: FloatArray) -> FloatArray:
    """Return how far zeros may have drifted beyond what is allowed for after a tare; 0 where that is little.

    Parameters
    ----------
    tracked
        The zeros of some readings.
    walk
        Their drift.
    mean_mm, variance_mm2
        The means of these readings, and the variances of their noise, both of shape (readings, channels); NaN for a
        channel without a mean.

    Returns
    -------
    Standard deviations of all channels together, and of each by itself, shape (readings, 2).
    """
    there, start_mm2 = ~np.isnan(mean_mm), walk.start_mm**2
    own_mm2 = np.where(there, tracked.own_mm, 0.0).max(axis=1) ** 2
    noise_mm2 = np.where(there, variance_mm2, np.inf).min(axis=1)
    matters = tracked.common_mm**2 + own_mm2 - start_mm2 > LITTLE * noise_mm2  # False without a channel
    own_mm = np.sqrt(np.maximum(own_mm2 - start_mm2, 0.0))
    beyond: FloatArray = np.where(matters[:, None], np.stack([tracked.common_mm, own_mm], axis=1), 0.0)
    return beyond
