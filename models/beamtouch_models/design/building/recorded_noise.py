"""The noise of a reading from samples of loads that rest, also if the samples are not independent. Pure.

Samples that a filter has made, or that repeat, follow each other more closely than their noise: means of them are less
exact than of as many readings. So the noise is taken from means of ever more neighbours (Allan, Proc. IEEE 54 (1966)
221): half the mean square of the difference between neighbouring means of n samples, times n, is the variance of a
sample if all are independent, and grows with n if they are not, up to that of independent readings which are as exact.
"""

import math
from collections.abc import Sequence

import numpy as np

from beamtouch_models.arrays import Floats

MEANS = 1, 2, 4, 8, 16, 32
"""Samples of a mean."""
PAIRS = 24
"""Neighbouring means from which a variance is taken, at least."""
SURELY = 4.0
"""Standard deviations by which samples are taken for dependent."""


def independent_variance(series: Sequence[Floats]) -> tuple[float, float]:
    """Return the variance of a sample, and that of an independent reading whose means are as exact.

    They are the same if the samples are independent. `series` are the samples of one sensor under one load (samples,),
    in order, two or more each; the variance of each is taken to be the same.
    """
    squares = sum(len(one) * float(one.var()) for one in series)
    variance = squares / sum(len(one) - 1 for one in series)
    found = []
    for count in MEANS:
        differences = np.concatenate([_differences(one, count) for one in series])
        if len(differences) >= PAIRS:
            # Neighbouring differences share a mean, so their squares are worth about two thirds of as many.
            found.append((count / 2 * float(np.mean(differences**2)), math.sqrt(3 / len(differences))))
    if not any(estimate * (1 - SURELY * error) > variance for estimate, error in found):
        return variance, variance
    return variance, max(estimate for estimate, _ in found)


def _differences(samples: Floats, count: int) -> Floats:
    """Return the differences (pairs,) of neighbouring means of `count` samples."""
    means = samples[: len(samples) // count * count].reshape(-1, count).mean(axis=1)
    return np.diff(means)
