"""Values that were measured at places, and how probable a smoothness is under them. Pure.

A Gaussian process, by its usual equations (Rasmussen & Williams, Gaussian Processes for Machine Learning, 2006). Places
are over the span of each axis, and values over their size.
"""

import math
from dataclasses import dataclass, replace
from typing import NamedTuple, Self

import numpy as np
from scipy.linalg import cho_solve, cholesky
from scipy.linalg.lapack import dpotri
from scipy.spatial.distance import cdist

from beamtouch_models.arrays import Bools, Floats, Indices

KERNELS = ((1, (1.0,)), (3, (1.0, 1.0)), (5, (1.0, 1.0, 1 / 3)), (7, (1.0, 1.0, 2 / 5, 1 / 15)))
"""Matern kernels of order 1/2, 3/2, 5/2 and 7/2: the square of the factor on the distance, and the coefficients of the
polynomial before the exponential, ascending (eq. 4.16). About a load, the influence of a string has a kink, and that of
a beam a third derivative that jumps."""
ROUGHEST = {1: 1, 2: 0}
"""The first kernel that is tried, by the number of axes. Loads on a plane are far apart: a skin may have a texture
between them, which only the roughest kernel allows for."""


class Smoothness(NamedTuple):
    """A kernel, its length scales, and the scatter of values, whose amplitude is 1."""

    kernel: int
    """Index in `KERNELS`."""
    scatter: float
    """Standard deviation of a value from the smooth function, at the largest force."""
    additive: float
    """The part of the scatter's variance that does not grow with the force, over that which does."""
    lengths: tuple[float, ...]
    """(axes,) length scales."""

    @property
    def proportional(self) -> float:
        """Variance of a value per newton that repeats anew with each load."""
        return self.scatter**2 / (1 + self.additive)

    def covariance(self, first: Floats, second: Floats) -> Floats:
        """Return the covariance (first, second) of the function at places (first, axes) and (second, axes)."""
        square, coefficients = KERNELS[self.kernel]
        scaled = cdist(first / self.lengths, second / self.lengths)
        scaled *= math.sqrt(square)
        values: Floats = np.full_like(scaled, coefficients[-1])
        for coefficient in coefficients[-2::-1]:
            values *= scaled
            values += coefficient
        np.negative(scaled, out=scaled)
        values *= np.exp(scaled)
        return values


@dataclass(frozen=True, eq=False)
class Process:
    """A Gaussian process that was fitted to values."""

    factor: Floats
    """Lower Cholesky factor of the covariance (places, places) of what was measured."""
    solved: Floats
    """(places, columns) inverse covariance times values."""
    square: Floats
    """(columns,) variance of the amplitude."""
    correlation: Floats
    """(columns, columns) of what the process leaves unknown, which is the same at all places."""
    log_probability: float
    """Of the values; amplitudes and correlations are integrated over."""


class Means(NamedTuple):
    """Means of the values at each place, weighted by their noise, whose scatter is 1."""

    mean: Floats
    """(places, columns)"""
    variance: Floats
    """(places,) of the means."""
    within: Floats
    """(columns, columns) sum of the products of the values about their means, over their variance."""
    log_variances: float
    """Logarithm of the product of the variances of the values, over those of the means."""


@dataclass(frozen=True, eq=False)
class Measured:
    """Columns of values that are known at the same places."""

    rows: Indices
    """(values,) of the table."""
    columns: Indices
    """(columns,) of the table."""
    place: Floats
    """(places, axes), each different."""
    place_of: Indices
    """(values,)"""
    values: Floats
    """(values, columns)"""
    weight: Floats
    """(values,) variance of the additive part of each value, over that at the largest force."""

    @classmethod
    def of(cls, rows: Indices, columns: Indices, place: Floats, values: Floats, weight: Floats) -> Self:
        """Take rows and columns of a table, of which all values are known."""
        places, place_of = np.unique(place[rows], axis=0, return_inverse=True)
        return cls(rows, columns, places, place_of.ravel(), values[np.ix_(rows, columns)], weight[rows])

    def thinned(self, most: int) -> Self:
        """Return the values at some of the places, drawn evenly and always the same."""
        kept = np.random.default_rng(0).permutation(len(self.place))[:most]
        return self._only(np.isin(self.place_of, kept))

    def without(self, row: int) -> Self:
        """Return all values but those in a row of the table."""
        return self._only(self.rows != row)

    def _only(self, is_kept: Bools) -> Self:
        places, place_of = np.unique(self.place_of[is_kept], return_inverse=True)
        return replace(
            self,
            rows=self.rows[is_kept],
            place=self.place[places],
            place_of=place_of,
            values=self.values[is_kept],
            weight=self.weight[is_kept],
        )

    def noise(self, smoothness: Smoothness) -> Floats:
        """Return the variance (places,) of what was measured at each place."""
        return smoothness.scatter**2 * self.means(smoothness.additive).variance

    def means(self, additive: float) -> Means:
        """Return the means at each place, of values with this part of additive scatter."""
        variances = self._variances(additive)
        count = len(self.place)
        total = np.bincount(self.place_of, 1 / variances, count)
        weighted = self.values / variances[:, None]
        mean = np.stack([np.bincount(self.place_of, one, count) for one in weighted.T], axis=1) / total[:, None]
        off = self.values - mean[self.place_of]
        within = off.T @ (off / variances[:, None])
        return Means(mean, 1 / total, within, float(np.log(variances).sum() + np.log(total).sum()))

    def process(self, smoothness: Smoothness) -> Process:
        """Return the process of a smoothness; LinAlgError if its covariance is singular.

        The mean of the values at a place, and their squares about it, tell all that the values do.
        """
        means, square = self.means(smoothness.additive), smoothness.scatter**2
        covariance = smoothness.covariance(self.place, self.place)
        covariance[np.diag_indices_from(covariance)] += square * means.variance
        factor = cholesky(covariance, lower=True, overwrite_a=True, check_finite=False)
        solved = cho_solve((factor, True), means.mean, check_finite=False)
        products = means.mean.T @ solved + means.within / square
        values, columns = self.values.shape
        squares, correlation = _correlation_of(products, values)
        log_determinant = (
            2 * np.log(np.diag(factor)).sum() + means.log_variances + (values - len(self.place)) * math.log(square)
        )
        log_volume = np.log(squares).sum() + np.linalg.slogdet(correlation)[1]
        log_probability = -columns / 2 * log_determinant - values / 2 * log_volume
        return Process(factor, solved, squares / max(values - 2, 1), correlation, float(log_probability))

    def left_out(self, smoothness: Smoothness) -> Floats:
        """Return each value (values, columns) less what the others say, over its deviation (eq. 5.12)."""
        means, square, process = self.means(smoothness.additive), smoothness.scatter**2, self.process(smoothness)
        inverse, _ = dpotri(process.factor, lower=True)
        noise = square * self._variances(smoothness.additive)[:, None]
        # The inverse covariance of the values from that of the means.
        share = square * means.variance[self.place_of][:, None] / noise
        solved = (self.values - means.mean[self.place_of]) / noise + share * process.solved[self.place_of]
        diagonal = (1 - share) / noise + share**2 * np.diag(inverse)[self.place_of][:, None]
        standardised: Floats = solved / np.sqrt(diagonal * process.square)
        return standardised

    def _variances(self, additive: float) -> Floats:
        """Return the variance (values,) of each value, whose scatter is 1."""
        variances: Floats = (1 + additive * self.weight) / (1 + additive)
        return variances


def _correlation_of(products: Floats, count: int) -> tuple[Floats, Floats]:
    """Return the diagonal (columns,) of products (columns, columns) of `count` values, and their correlation.

    Few values correlate by chance: the correlation counts as if as many more as there are columns, and one, had none.
    """
    squares, columns = np.diag(products), len(products)
    deviation = np.sqrt(squares)
    correlation = products / deviation / deviation[:, None]
    correlation *= count / (count + columns + 1)
    correlation[np.diag_indices(columns)] = 1.0
    return squares, correlation


def measured_together(place: Floats, values: Floats, weight: Floats) -> tuple[Measured, ...]:
    """Return the columns of values (values, columns), those with the same missing ones, which are NaN, together."""
    is_known: Bools = np.isfinite(values)
    patterns, pattern_of = np.unique(is_known, axis=1, return_inverse=True)
    return tuple(
        Measured.of(np.flatnonzero(pattern), np.flatnonzero(pattern_of.ravel() == index), place, values, weight)
        for index, pattern in enumerate(patterns.T)
    )
