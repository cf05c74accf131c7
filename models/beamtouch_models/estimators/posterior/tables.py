"""The constants of the posterior graph."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beamtouch_models.estimators.posterior.cells import Design, cells_of
from beamtouch_models.prior import Prior

Array = NDArray[np.float64]

REST_WEIGHT = 1000.0
"""Log weight by which a beam at rest is disfavoured in the posterior, to take no part where something touches."""
FIRST = 0.02
"""Share of it that stands before the range: less than the lowest quantile, so that none of them falls before it."""
RESOLVED = 0.5
"""Cell of a known force, in deviations of the noise, up to which nothing is tempered."""
TINY = 1e-12
"""Added to sums of squared influence, over the largest, so that no channel at all divides by something."""


@dataclass(frozen=True)
class Tables:
    """One entry per cell, and one before and one after them for the beam at rest; N in all."""

    influence: Array
    """(channels, N) mm/N."""
    low_n: Array
    high_n: Array
    """(N,) bounds of the best force."""
    log_weight: Array
    """(N,) logarithm of a cell's share of the range and of the width of the force's posterior."""
    temper: Array
    """(N,) k: the likelihood is widened by t = 1 + k |z|^2 / s^2, where the force is known by 1 + k."""
    width_mm: Array
    """(N,) of the cells; the first entry is where the range starts."""
    middle_mm: Array
    """(N,) of the cells."""
    force_variance: Array
    """(N,) N^2, of the force at a position."""

    @property
    def squares(self) -> Array:
        """(channels, N) squared influence."""
        return self.influence**2

    @property
    def tiny(self) -> float:
        """What keeps a division by no influence finite."""
        return TINY * float(self.squares.sum(axis=0).max())


def tables_of(prior: Prior, design: Design) -> Tables:
    """Compute the tables; float64."""
    low, high = prior.force_n
    known, span = low == high, high - low
    cells = cells_of(prior, design.cells)
    influence = np.pad(cells.influence, ((1, 1), (0, 0)))
    precision = (influence**2).sum(axis=1) / prior.noise_mm**2
    width = np.pad(np.diff(cells.edges_mm), 1)
    share = np.maximum(width / width.sum(), np.finfo(np.float64).tiny)
    temper = np.pad(cells.step**2, 1)
    inset, variance = np.zeros_like(precision), np.zeros_like(precision)
    if known:
        temper = np.maximum(temper - RESOLVED**2, 0.0)
    else:
        # The width of a Gaussian cut off by the range: right where either is much the wider, within 1 % between.
        share = share * np.sqrt(2 * np.pi / (precision + 2 * np.pi / span**2)) / span
        inset, variance = 1 / np.sqrt(precision + (2 / span) ** 2), 1 / (precision + 12 / span**2)
    log_weight = np.log(share)
    log_weight[[0, -1]] = np.log([FIRST, 1 - FIRST]) - REST_WEIGHT
    width[0] = cells.edges_mm[0]
    middle = np.concatenate([cells.edges_mm[:1], cells.middles_mm, cells.edges_mm[-1:]])
    return Tables(influence.T, low + inset, high - inset, log_weight, temper, width, middle, variance)
