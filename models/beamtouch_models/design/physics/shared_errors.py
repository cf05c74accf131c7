"""The part of the errors of several sensors that comes from a few sources which they share. Pure.

Factors of a correlation by iterated principal axes (Harman, Modern Factor Analysis, 1976, chapter 8): the correlation
of two sensors is the product of their loadings, summed over the sources.
"""

import numpy as np

from beamtouch_models.arrays import Floats

SOURCES = 4
"""Most sources. On a published skin with 15 channels, a fifth one makes errors no smaller."""
LEAST_OWN = 0.05
"""Smallest part of a sensor's variance that is its own."""
LEAST_SQUARE = 0.1
"""Smallest sum of the squares of the loadings of a source that counts: less is chance, or makes no difference."""
RIDGE = 1e-6
"""Added to the variances, for the inverse."""
ROUNDS = 50
"""Of the iteration, which moves no loading by more than a few thousandths after half as many."""


def loadings_of(correlation: Floats) -> Floats:
    """Return the loadings (sensors, sources) of a correlation (sensors, sensors), the largest source first.

    The squares of a sensor's loadings add up to the part of its variance that it shares.
    """
    sensors = len(correlation)
    loadings: Floats = np.zeros((sensors, 0))
    # The part that the other sensors do not tell; without the ridge, sensors that are alike would have no inverse.
    own = 1 / np.diag(np.linalg.inv(correlation + RIDGE * np.eye(sensors)))
    for _ in range(ROUNDS):
        squares, axes = np.linalg.eigh(correlation - np.diag(own))
        kept = np.arange(sensors)[::-1][: min(SOURCES, sensors - 1)]
        kept = kept[squares[kept] > LEAST_SQUARE]
        loadings = axes[:, kept] * np.sqrt(squares[kept])
        own = np.clip(1 - (loadings**2).sum(axis=1), LEAST_OWN, 1.0)
    # Where a sensor would share more than all, its loadings shrink.
    shared = (loadings**2).sum(axis=1)
    loadings *= np.sqrt(np.minimum(1.0, (1 - LEAST_OWN) / np.maximum(shared, LEAST_OWN)))[:, None]
    return loadings
