"""Simulated readings behind the filter of the daemon: their samples, draw by draw. Pure."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from beamtouch_models.arrays import Bools, Floats
from beamtouch_models.filters import Chain, Walk, Zeros, beyond_start


@dataclass(frozen=True, eq=False)
class Samples:
    """Samples of draws as the daemon sends them, one for each reading that was asked for."""

    mean_mm: Floats
    """(draws, samples, channels), from zeros that are tracked, if they are; NaN of a channel that takes no part, as its
    newest reading is not good or there is no mean of it, and of a reading that is lost."""
    covariance_mm2: Floats
    """(draws, samples, channels, channels), of the means; 0 of a channel without a mean."""
    relative_variance: Floats
    """(draws, samples, channels), variance of the noise of the means over that of a reading; NaN without a mean."""
    drift_mm: Floats
    """(draws, samples, 2), how far zeros may have drifted beyond what is allowed for after a tare, as `beyond_start`
    returns it; 0 if they are not tracked."""


def replay(
    chain: Chain,
    readings_mm: Floats,
    asked: Sequence[int] | None = None,
    *,
    came: Bools | None = None,
    tracking: tuple[Walk, Zeros] | None = None,
) -> Samples:
    """Return the samples of readings behind a filter, which begins anew with each draw.

    Parameters
    ----------
    chain : the filter, which knows the noise of a reading
    readings_mm : (draws, readings, channels), oldest first; NaN where a channel is not good
    asked : ascending numbers of the readings whose samples are returned; None: all
    came : (draws, readings), False where a reading is lost; None: none is
    tracking : the drift of the zeros and what tracks them; None: they stay
    """
    draws, length, channels = readings_mm.shape
    numbers = np.arange(length) if asked is None else np.asarray(asked, np.intp)
    end = int(numbers.max(initial=-1)) + 1  # no sample depends on later readings
    mean_mm, relative_variance = np.full((2, draws, len(numbers), channels), np.nan)
    covariance_mm2, drift_mm = np.zeros((draws, len(numbers), channels, channels)), np.zeros((draws, len(numbers), 2))
    for draw, readings in enumerate(readings_mm[:, :end]):
        there = np.arange(end) if came is None else np.flatnonzero(came[draw, :end])
        if not len(there):  # a filter takes one reading or more
            continue
        lost = (np.diff(there, prepend=-1) - 1).tolist()
        chain.restart()
        filtered = chain.apply(readings[there], lost)
        answered = np.isin(numbers, there)
        rows = np.searchsorted(there, numbers[answered])
        mean_mm[draw, answered] = filtered.mean_mm[rows]
        relative_variance[draw, answered] = filtered.relative_variance[rows]
        covariance_mm2[draw, answered] = filtered.covariances_mm2(rows)
        if tracking is not None and filtered.noise_mm is not None:
            walk, zeros = tracking
            zeros.restart()
            tracked = zeros.track(readings[there], lost, filtered)
            mean_mm[draw, answered] -= tracked.zero_mm[rows]
            noise_mm2 = filtered.relative_variance * filtered.noise_mm**2
            drift_mm[draw, answered] = beyond_start(tracked, walk, filtered.mean_mm, noise_mm2)[rows]
    # A channel whose newest reading is not good takes no part, whatever its filter still holds.
    mean_mm[np.isnan(readings_mm[:, numbers])] = np.nan
    return Samples(mean_mm, covariance_mm2, relative_variance, drift_mm)
