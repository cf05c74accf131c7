"""The constants of the posterior graph."""

from dataclasses import dataclass

import numpy as np

from beamtouch_models.accuracy.prior import Prior
from beamtouch_models.arrays import Floats
from beamtouch_models.estimators.posterior.cells import Design, cells_of

REST_WEIGHT = 1000.0
"""Negative log weight of rest in the posterior, so large that rest has no effect where something touches."""
FIRST = 0.02
"""Share of rest in the cell before the range: less than the lowest quantile, so that all quantiles lie in the range."""
RESOLVED = 0.5
"""Largest cell, in deviations of the noise, that is not tempered, for a known force."""
TINY = 1e-12
"""Added to sums of squared influence, relative to the largest, so that a sample without channels divides by no 0."""


@dataclass(frozen=True)
class Tables:
    """Constants per cell, with one rest cell before and one after the cells of the range; N in all."""

    influence: Floats
    """(channels, N) mm/N."""
    low_n: Floats
    high_n: Floats
    """(N,) bounds of the best force."""
    log_weight: Floats
    """(N,) logarithm of a cell's share of the range times the width of the force's posterior."""
    temper: Floats
    """(N,) k: the likelihood is widened by t = 1 + k |z|^2 / s^2, or by 1 + k if the force is known."""
    width_mm: Floats
    """(N,) widths of the cells; the first entry is the start of the range."""
    middle_mm: Floats
    """(N,) middles of the cells."""
    force_variance: Floats
    """(N,) variance of the force at a position, in N^2."""

    @property
    def squares(self) -> Floats:
        """(channels, N) squared influence."""
        return self.influence**2

    @property
    def tiny(self) -> float:
        """Addend that keeps a division by zero influence finite."""
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
        # The width of a Gaussian cut off by the range: exact if either is much wider, within 1 % in between.
        share = share * np.sqrt(2 * np.pi / (precision + 2 * np.pi / span**2)) / span
        inset, variance = 1 / np.sqrt(precision + (2 / span) ** 2), 1 / (precision + 12 / span**2)
    log_weight = np.log(share)
    log_weight[[0, -1]] = np.log([FIRST, 1 - FIRST]) - REST_WEIGHT
    width[0] = cells.edges_mm[0]
    middle = np.concatenate([cells.edges_mm[:1], cells.middles_mm, cells.edges_mm[-1:]])
    return Tables(influence.T, low + inset, high - inset, log_weight, temper, width, middle, variance)
