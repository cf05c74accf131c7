"""Regions of a branch and bound: sets of layouts with an upper bound, and their exploration as tasks."""

import math
from dataclasses import dataclass

import numpy as np

from beamtouch_models.arrays import Bools, Floats, Indices
from beamtouch_models.placement.bound import Bounder
from beamtouch_models.placement.problem import Problem

MARGIN = 1e-8
"""Generous bound on rounding errors of a bound or a score, in log units; scores this close are equal. If the components
differ very much in size, the larger `proof.rounding_margin` applies."""
ENUMERATED = 4_096
"""Regions of up to this many layouts are scored layout by layout instead of being split further."""
STEPS = 12
FLOOR = 1e-9
"""Smallest weight. A weight of 0 could not grow again, and denormal products would be slow."""
QUICK = 1e-6
"""Generous bound on the error of a quick score."""


@dataclass(frozen=True)
class Region:
    """A set of layouts with an upper bound on their scores."""

    bound: float
    mask: Bools
    """(sensors, candidates), True where the k-th sensor from the left may be."""
    weights: Floats
    """(sensors, candidates), summing to 1 in each row."""


@dataclass(frozen=True)
class Exploration:
    """A region to explore, as a task that can be sent."""

    bounder: Bounder
    """Of the problem, whose matrix is not needed."""
    region: Region
    score: float
    """The best known score."""
    limit: float
    """The score that a layout must exceed to be better."""


@dataclass(frozen=True)
class Explored:
    """The outcome of an exploration."""

    parts: tuple[Region, ...] = ()
    """Regions that are left to explore."""
    layouts: tuple[Indices, ...] = ()
    """Layouts that may be better than the best known one, by their quick scores."""
    bounded: int = 0
    """Number of regions that were bounded."""
    evaluations: int = 0
    """Number of layouts scored."""


def explored(task: Exploration) -> Explored:
    """Score every layout of a small region, or split a large one."""
    region = task.region
    if math.prod(region.mask.sum(axis=1).tolist()) <= ENUMERATED:
        return _enumerated(task.bounder.problem, region.mask, task.score)
    parts = [tightened(task.bounder, mask, region.weights, STEPS, task.limit, region.bound) for mask in _split(region)]
    return Explored(parts=tuple(part for part in parts if part is not None), bounded=len(parts))


def tightened(
    bounder: Bounder, mask: Bools, weights: Floats, steps: int, limit: float, known: float = np.inf
) -> Region | None:
    """Return a region with its bound, without the candidates that the bound excludes; None if nothing is left.

    Parameters
    ----------
    mask, weights : the region, and the weights to start from; both (sensors, candidates)
    steps : number of bounds to compute
    limit : the score that a layout must exceed to be of interest
    known : a bound that is known already
    """
    weights = _within(mask, weights)
    bound, best = known, weights
    for _ in range(steps):
        found = bounder.bound(weights.sum(axis=0), mask)
        mask = mask & (found.through > limit)
        if found.value < bound:
            bound, best = found.value, weights
        if not mask.any(axis=1).all():
            return None
        weights = _within(mask, weights * found.price)
    return Region(bound, mask, _within(mask, best))


def _enumerated(problem: Problem, mask: Bools, score: float) -> Explored:
    choices = np.meshgrid(*(np.flatnonzero(row) for row in mask), indexing="ij")
    layouts = np.stack([choice.ravel() for choice in choices], axis=1)
    layouts = layouts[np.all(np.diff(layouts, axis=1) > 0, axis=1)]
    if not len(layouts):
        return Explored()
    scores = problem.scores(layouts)
    best = np.flatnonzero(scores > max(float(scores.max()), score) - QUICK)
    return Explored(layouts=tuple(layouts[best]), evaluations=len(layouts))


def _within(mask: Bools, weights: Floats) -> Floats:
    """Restrict weights to a region; each row sums to 1, and no weight inside is 0, so that it can grow again."""
    inside = np.where(mask, np.maximum(weights, FLOOR), 0.0)
    normal: Floats = inside / inside.sum(axis=1, keepdims=True)
    return normal


def _split(region: Region) -> list[Bools]:
    """Split a region at the sensor that the relaxation spreads most, at the mean of its weights."""
    index = np.arange(region.mask.shape[1])
    mean = region.weights @ index
    variance = region.weights @ index**2 - mean**2
    counts = region.mask.sum(axis=1)
    row = int(np.where(counts > 1, variance + 1e-3 * counts, -1.0).argmax())
    allowed = np.flatnonzero(region.mask[row])
    middle = int(np.clip(np.ceil(mean[row]), allowed[0] + 1, allowed[-1]))
    left, right = region.mask.copy(), region.mask.copy()
    left[row, middle:] = False
    right[row, :middle] = False
    return [left, right]
