"""A smooth function through measured values, how uncertain it is between them, and how well the values repeat.

A Gaussian process with Matern kernels (Rasmussen & Williams, Gaussian Processes for Machine Learning, 2006, chapters 2
and 4). All columns of values, the sensors of one structure, share smoothness, length scale and noise over amplitude;
each has an amplitude of its own, and they are correlated (Bonilla, Chai & Williams, Multi-task Gaussian process
prediction, 2007). None of these is chosen: each combination of a grid counts by the probability of the
values under it (sec. 5.2), so that few values do not pretend to know them.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import Self

import numpy as np
from scipy.linalg import solve_triangular

from beamtouch_models.arrays import Floats
from beamtouch_models.design.physics.smoothness import KERNELS, ROUGHEST, Measured, Smoothness, measured_together
from beamtouch_models.design.sweeps import one_thread

LENGTHS = np.geomspace(0.08, 4.0, 17)
"""Length scales along each axis, over the span of the places."""
SCATTERS = np.geomspace(1e-5, 0.5, 25)
"""Standard deviations of a value from the smooth function, over the amplitude."""
ADDITIVE = (0.0, 0.5, 4.0)
"""Parts of the scatter that do not grow with the force, at the largest force, over those that do."""
STEPS: tuple[int, ...] = (8, 4, 2, 1)
STEPS_NEAR: tuple[int, ...] = (2, 1)
"""Of the search along scatters and lengths, and where the best combination is known about."""
MIDDLE, SCATTER = 2, 2
"""The kernel with which the search begins, and the axis of the scatters, behind kernel and additive part."""
BEST, IMPROBABLE = 8, 10.0
"""So many of the best combinations have their neighbours looked at, and those whose probability is larger than that of
the best one over e to this power."""
MANY = 300
"""Of more places than this, so many are searched first, and all of them only near what those find probable."""
DRAWS = 48
"""Combinations that are drawn by their probability, evenly, as some are drawn several times."""


@dataclass(frozen=True, eq=False)
class SmoothFit:
    """A smooth function of each column of values, with what is not known of it."""

    place_mm: Floats
    """(values, axes)"""
    span_mm: Floats
    """(axes,)"""
    measured: tuple[Measured, ...]
    """The values of columns that are known at the same places, over `scale`."""
    scale: Floats
    """(columns,)"""
    combinations: tuple[Smoothness, ...]
    weights: Floats
    """(combinations,), their sum is 1."""
    strongest_n: float
    """The largest force with which values were measured."""

    @classmethod
    def of(cls, place_mm: Floats, values: Floats, force_n: Floats) -> Self:
        """Fit values per newton to places.

        Parameters
        ----------
        place_mm : (values, axes)
        values : (values, columns), NaN where a column is not known; each is known at two places or more
        force_n : (values,), the force with which each was measured
        """
        span_mm = np.ptp(place_mm, axis=0)
        scale = np.sqrt(np.nanmean(values**2, axis=0))
        weight = (force_n.max() / force_n) ** 2
        measured = measured_together(place_mm / span_mm, values / scale, weight)
        additive = ADDITIVE if np.ptp(weight) > 0 else ADDITIVE[:1]
        with one_thread():
            tried = _probable(measured, additive, place_mm.shape[1])
        in_order = sorted(tried, key=lambda combination: -tried[combination])
        logs = np.array([tried[combination] for combination in in_order])
        share = np.cumsum(np.exp(logs - logs[0]))
        drawn = np.searchsorted(share / share[-1], (np.arange(DRAWS) + 0.5) / DRAWS)
        kept, times = np.unique(drawn, return_counts=True)
        return cls(
            place_mm, span_mm, measured, scale, tuple(in_order[index] for index in kept), times / DRAWS, force_n.max()
        )

    def at(self, place_mm: Floats) -> tuple[Floats, Floats]:
        """Return the function and its standard deviation (places, columns) at places (places, axes)."""
        mean, square = np.zeros((2, len(place_mm), len(self.scale)))
        for weight, one, part in self._parts():
            towards = one.covariance(place_mm / self.span_mm, part.place)
            process = part.process(one)
            inner = towards @ process.solved
            left = solve_triangular(process.factor, towards.T, lower=True, check_finite=False)
            variance = (1 - (left**2).sum(axis=0))[:, None] * process.square
            mean[:, part.columns] += weight * inner
            square[:, part.columns] += weight * (variance + inner**2)
        return mean * self.scale, np.sqrt(np.maximum(square - mean**2, 0.0)) * self.scale

    def draw(self, place_mm: Floats, rng: np.random.Generator) -> Floats:
        """Draw a function that agrees with the values; returns it (places, columns) at places (places, axes)."""
        one = self.combinations[int(rng.choice(len(self.weights), p=self.weights))]
        drawn, places = np.empty((len(place_mm), len(self.scale))), place_mm / self.span_mm
        for part in self.measured:
            towards, process = one.covariance(places, part.place), part.process(one)
            left = solve_triangular(process.factor, towards.T, lower=True, check_finite=False)
            variances, shapes = np.linalg.eigh(one.covariance(places, places) - left.T @ left)
            independent = rng.normal(size=(len(place_mm), len(part.columns)))
            normal = independent @ np.linalg.cholesky(process.correlation).T * np.sqrt(process.square)
            drawn[:, part.columns] = towards @ process.solved + shapes @ (
                np.sqrt(np.maximum(variances, 0.0))[:, None] * normal
            )
        return drawn * self.scale

    @cached_property
    def repeatability(self) -> Floats:
        """(columns,) standard deviation by which values per newton differ when a load is put on anew."""
        variance = np.zeros(len(self.scale))
        for weight, one, part in self._parts():
            variance[part.columns] += weight * one.proportional * part.process(one).square
        return np.sqrt(variance) * self.scale

    @cached_property
    def correlation(self) -> Floats:
        """(columns, columns) of what is not known of the values, between places and from load to load."""
        correlation = np.eye(len(self.scale))
        for part in self.measured:
            together = zip(self.weights.tolist(), self.combinations, strict=True)
            correlation[np.ix_(part.columns, part.columns)] = sum(
                weight * part.process(one).correlation for weight, one in together
            )
        return correlation

    def scatter_under(self, force_n: float) -> Floats:
        """Return the standard deviation (columns,) of a value that is measured with a force, about the function."""
        variance, light = np.zeros(len(self.scale)), (self.strongest_n / force_n) ** 2
        for weight, one, part in self._parts():
            scatter = one.scatter**2 * (1 + one.additive * light) / (1 + one.additive)
            variance[part.columns] += weight * scatter * part.process(one).square
        return np.sqrt(variance) * self.scale

    @cached_property
    def left_out(self) -> Floats:
        """(values, columns), each value less what the others say, over its deviation; 0 where there is none."""
        left_out = np.zeros((len(self.place_mm), len(self.scale)))
        for weight, one, part in self._parts():
            left_out[np.ix_(part.rows, part.columns)] += weight * part.left_out(one)
        return left_out

    def without(self, value: int) -> Self:
        """Return the fit with the same smoothness to all values but one, which stays in the count of values."""
        return replace(self, measured=tuple(part.without(value) for part in self.measured))

    def variance_with(self, more_mm: Floats, place_mm: Floats) -> Floats:
        """Return the variance (places, columns) at places if one value more were measured at each of `more_mm`.

        Both are (places, axes).
        """
        variance = np.zeros((len(place_mm), len(self.scale)))
        for weight, one, part in self._parts():
            process, noise = part.process(one), part.noise(one)
            known = np.concatenate([part.place, more_mm / self.span_mm])
            covariance = one.covariance(known, known)
            covariance[np.diag_indices_from(covariance)] += np.append(noise, np.full(len(more_mm), noise.min()))
            towards = one.covariance(known, place_mm / self.span_mm)
            left = np.linalg.solve(np.linalg.cholesky(covariance), towards)
            variance[:, part.columns] += weight * np.maximum(1 - (left**2).sum(axis=0), 0.0)[:, None] * process.square
        return variance * self.scale**2

    def _parts(self) -> Iterator[tuple[float, Smoothness, Measured]]:
        """Yield each combination with its weight, and with each part of the columns."""
        for (weight, one), part in product(zip(self.weights.tolist(), self.combinations, strict=True), self.measured):
            yield weight, one, part


_Index = tuple[int, ...]
"""Of a combination in the grid: kernel, additive part, scatter, and length along each axis."""


def _probable(measured: tuple[Measured, ...], additive: tuple[float, ...], axes: int) -> dict[Smoothness, float]:
    """Return the logarithm of the probability of the combinations that are not improbable.

    From a coarse grid of them, the search goes on to the neighbours of the best and of all that are not improbable, in
    ever shorter steps: if values are many, it never looks at most of the fine grid.
    """
    sizes = (len(KERNELS), len(additive), len(SCATTERS), *[len(LENGTHS)] * axes)
    waiting = set(product([MIDDLE], range(len(additive)), *(range(0, size, STEPS[0]) for size in sizes[2:])))
    steps = STEPS
    if any(len(part.place) > MANY for part in measured):
        tried = _searched(tuple(part.thinned(MANY) for part in measured), additive, waiting, steps)
        waiting, steps = {max(tried, key=lambda index: tried[index][1])}, STEPS_NEAR
    return dict(_searched(measured, additive, waiting, steps).values())


def _searched(
    measured: tuple[Measured, ...], additive: tuple[float, ...], waiting: set[_Index], steps: tuple[int, ...]
) -> dict[_Index, tuple[Smoothness, float]]:
    """Return the combinations with the logarithms of their probabilities, to which steps lead from those waiting."""
    axes = len(next(iter(waiting))) - SCATTER - 1
    sizes = (len(KERNELS), len(additive), len(SCATTERS), *[len(LENGTHS)] * axes)
    tried: dict[_Index, tuple[Smoothness, float]] = {}
    for step in steps:
        while waiting:
            for index in sorted(waiting):
                kernel, share, scatter, *lengths = index
                one = Smoothness(kernel, float(SCATTERS[scatter]), additive[share], tuple(LENGTHS[lengths].tolist()))
                tried[index] = one, math.fsum(_log_probability(part, one) for part in measured)
            waiting = _near_the_best(tried, sizes, step)
        waiting = _near_the_best(tried, sizes, max(step // 2, 1))
    return tried


def _near_the_best(tried: dict[_Index, tuple[Smoothness, float]], sizes: _Index, step: int) -> set[_Index]:
    """Return the neighbours that were not tried yet of the best and of all that are not improbable."""
    ranked = sorted(tried, key=lambda index: -tried[index][1])
    least = tried[ranked[0]][1] - IMPROBABLE
    good = [index for rank, index in enumerate(ranked) if rank < BEST or tried[index][1] >= least]
    return {near for index in good for near in _neighbours(index, sizes, step)} - tried.keys()


def _log_probability(measured: Measured, smoothness: Smoothness) -> float:
    """Return the logarithm of the probability of values; minus infinity if rounding makes the covariance singular."""
    try:
        return measured.process(smoothness).log_probability
    except np.linalg.LinAlgError:
        return -math.inf


def _neighbours(index: _Index, sizes: _Index, step: int) -> Iterator[_Index]:
    """Yield the indices one step away along one axis of a grid; kernel and additive part go by single steps."""
    roughest = ROUGHEST[len(index) - SCATTER - 1]
    for axis, (at, size) in enumerate(zip(index, sizes, strict=True)):
        wide = step if axis >= SCATTER else 1
        for near in (at - wide, at + wide):
            if (roughest if axis == 0 else 0) <= near < size:
                yield (*index[:axis], near, *index[axis + 1 :])
