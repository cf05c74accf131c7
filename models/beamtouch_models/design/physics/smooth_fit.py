"""A smooth function through measured values, how uncertain it is between them, and how well the values repeat.

A Gaussian process with Matern kernels (Rasmussen & Williams, Gaussian Processes for Machine Learning, 2006, chapters 2
and 4). All columns of values, the sensors of one structure, share smoothness, length scale and noise over amplitude;
each has an amplitude of its own. None of these is chosen: each combination of a grid counts by the probability of the
values under it (sec. 5.2), so that few values do not pretend to know them.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Self

import numpy as np
from numpy.polynomial import Polynomial
from scipy.linalg import cho_factor, cho_solve, solve_triangular
from scipy.linalg.lapack import dpotri

from beamtouch_models.arrays import Floats

SMOOTHNESS = (
    (math.sqrt(3), Polynomial([1, 1])),
    (math.sqrt(5), Polynomial([1, 1, 1 / 3])),
    (math.sqrt(7), Polynomial([1, 1, 2 / 5, 1 / 15])),
)
"""Matern kernels of order 3/2, 5/2 and 7/2: factor on the distance, and the polynomial before the exponential (eq.
4.16). About a load, the influence of a string has a kink, and that of a beam a third derivative that jumps."""
LENGTHS = np.geomspace(0.08, 4.0, 10)
"""Length scales, over the span of the places."""
SCATTERS = np.geomspace(1e-5, 0.5, 11)
"""Standard deviations of a value from the smooth function, over the amplitude."""
ADDITIVE = (0.0, 0.5, 4.0)
"""Parts of the scatter that do not grow with the force, at the largest force, over those that do."""
DRAWS = 48
"""Combinations that are drawn by their probability, evenly, as some are drawn several times."""


@dataclass(frozen=True, eq=False)
class _Combination:
    """A smooth fit with one kernel and one noise."""

    kernel: tuple[float, Polynomial]
    length: float
    """Over the span."""
    diagonal: Floats
    """(values,) variance of each value, over that of the amplitude."""
    proportional: float
    """Variance of a value per newton that repeats anew with each load, over that of the amplitude."""
    factor: Floats
    """Lower Cholesky factor (values, values)."""
    solved: Floats
    """(values, columns) inverse covariance times values."""
    square: Floats
    """(columns,) variance of the amplitude."""
    log_probability: float

    @classmethod
    def of(
        cls,
        kernel: tuple[float, Polynomial],
        apart: Floats,
        length: float,
        noise: tuple[float, float],
        weight: Floats,
        values: Floats,
    ) -> Self | None:
        """Return the fit of values (values, columns) whose places are `apart` (values, values); None if singular."""
        scatter, additive = noise
        diagonal = scatter**2 * (1 + additive * weight) / (1 + additive)
        covariance = _matern(kernel, apart / length)
        covariance[np.diag_indices_from(covariance)] += diagonal
        try:
            factor, _ = cho_factor(covariance, lower=True, check_finite=False)
        except np.linalg.LinAlgError:
            return None
        solved = cho_solve((factor, True), values, check_finite=False)
        squares, count = (values * solved).sum(axis=0), len(values)
        # The amplitude is integrated over, with a prior of 1 / amplitude.
        log_probability = -len(squares) * np.log(np.diag(factor)).sum() - count / 2 * np.log(squares).sum()
        square = squares / max(count - 2, 1)
        return cls(
            kernel, length, diagonal, scatter**2 / (1 + additive), factor, solved, square, float(log_probability)
        )

    def at(self, apart: Floats) -> tuple[Floats, Floats]:
        """Return mean and variance (places, columns) at places that are `apart` (places, values) from the values."""
        towards = _matern(self.kernel, apart / self.length)
        left = solve_triangular(self.factor, towards.T, lower=True, check_finite=False)
        return towards @ self.solved, np.maximum(1 - (left**2).sum(axis=0), 0.0)[:, None] * self.square

    @cached_property
    def left_out(self) -> Floats:
        """(values, columns), each value less what the others say, over its deviation (eq. 5.12)."""
        inverse, _ = dpotri(self.factor, lower=True)
        diagonal = np.diag(inverse)[:, None]
        standardised: Floats = self.solved / np.sqrt(diagonal * self.square)
        return standardised


@dataclass(frozen=True, eq=False)
class SmoothFit:
    """A smooth function of each column of values, with what is not known of it."""

    place_mm: Floats
    """(values,)"""
    span_mm: float
    combinations: tuple[_Combination, ...]
    weights: Floats
    """(combinations,), their sum is 1."""

    @classmethod
    def of(cls, place_mm: Floats, values: Floats, force_n: Floats) -> Self:
        """Fit values (values, columns) per newton at places (values,), each measured with a force (values,)."""
        span_mm = float(np.ptp(place_mm))
        apart = np.abs(place_mm[:, None] - place_mm) / span_mm
        scale = np.sqrt(np.mean(values**2, axis=0))
        weight = (force_n.max() / force_n) ** 2
        additive = ADDITIVE if np.ptp(weight) > 0 else ADDITIVE[:1]
        tried = [
            _Combination.of(kernel, apart, length, noise, weight, values / scale)
            for kernel, length, noise in product(SMOOTHNESS, LENGTHS, product(SCATTERS, additive))
        ]
        possible = [one for one in tried if one is not None]
        possible = sorted(possible, key=lambda one: -one.log_probability)
        logs = np.array([one.log_probability for one in possible])
        share = np.cumsum(np.exp(logs - logs[0]))
        drawn = np.searchsorted(share / share[-1], (np.arange(DRAWS) + 0.5) / DRAWS)
        kept, times = np.unique(drawn, return_counts=True)
        return cls(place_mm, span_mm, tuple(_scaled(possible[index], scale) for index in kept), times / DRAWS)

    def at(self, place_mm: Floats) -> tuple[Floats, Floats]:
        """Return the function and its standard deviation (places, columns) at places (places,)."""
        apart = np.abs(place_mm[:, None] - self.place_mm) / self.span_mm
        parts = [one.at(apart) for one in self.combinations]
        mean: Floats = np.einsum("k,kpc->pc", self.weights, np.array([mean for mean, _ in parts]))
        variance = [variance + (part - mean) ** 2 for part, variance in parts]
        return mean, np.sqrt(np.einsum("k,kpc->pc", self.weights, np.array(variance)))

    @cached_property
    def repeatability(self) -> Floats:
        """(columns,) standard deviation by which values per newton differ when a load is put on anew."""
        variance = np.array([one.proportional * one.square for one in self.combinations])
        deviation: Floats = np.sqrt(self.weights @ variance)
        return deviation

    @cached_property
    def left_out(self) -> Floats:
        """(values, columns), each value less what the others say, over its deviation."""
        left_out = np.array([one.left_out for one in self.combinations])
        standardised: Floats = np.einsum("k,kvc->vc", self.weights, left_out)
        return standardised

    def variance_with(self, more_mm: Floats, place_mm: Floats) -> Floats:
        """Return the variance (places, columns) at places if one value more were measured at each of `more_mm`."""
        known = np.concatenate([self.place_mm, more_mm])
        apart = np.abs(known[:, None] - known) / self.span_mm
        towards = np.abs(place_mm[:, None] - known) / self.span_mm
        variance = np.zeros((len(place_mm), len(self.combinations[0].square)))
        for weight, one in zip(self.weights, self.combinations, strict=True):
            covariance = _matern(one.kernel, apart / one.length)
            more = np.full(len(more_mm), one.diagonal.min())
            covariance[np.diag_indices_from(covariance)] += np.concatenate([one.diagonal, more])
            left = np.linalg.solve(np.linalg.cholesky(covariance), _matern(one.kernel, towards / one.length).T)
            variance += weight * np.maximum(1 - (left**2).sum(axis=0), 0.0)[:, None] * one.square
        return variance


def _scaled(one: _Combination, scale: Floats) -> _Combination:
    """Return the fit of values that are `scale` (columns,) times as large."""
    return _Combination(
        one.kernel,
        one.length,
        one.diagonal,
        one.proportional,
        one.factor,
        one.solved * scale,
        one.square * scale**2,
        one.log_probability,
    )


def _matern(kernel: tuple[float, Polynomial], apart: Floats) -> Floats:
    """Return the kernel of distances over the length scale."""
    factor, polynomial = kernel
    scaled = factor * apart
    values: Floats = polynomial(scaled) * np.exp(-scaled)
    return values
