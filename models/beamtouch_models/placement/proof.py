"""Branch and bound: proves that a layout is the best on the grid, or bounds how much better another could be."""

import heapq
import math
from dataclasses import dataclass, field

import numpy as np

from beamtouch_models.arrays import Bools, Floats, Indices
from beamtouch_models.placement.bound import Bounder, bounder_of
from beamtouch_models.placement.problem import Problem
from beamtouch_models.progress import Fraction, silent

Region = Bools

MARGIN = 1e-8
"""Generous bound on rounding errors of a bound or a score, in log units; scores this close are equal. If the components
differ very much in size, the larger `rounding_margin` applies."""
LARGEST_MARGIN = 1e-6
"""With a larger margin, no layout counts as proven."""
MAX_REGIONS = 3_000
ENUMERATED = 4_096
"""Regions of up to this many layouts are scored layout by layout instead of being split further."""
ROOT_STEPS = 150
STEPS = 12
FLOOR = 1e-9
"""Smallest weight. A weight of 0 could not grow again, and denormal products would be slow."""


@dataclass(frozen=True)
class Proof:
    """The outcome of a proof."""

    layout: Indices
    """The best known layout, which may be better than the given one."""
    score: float
    gap: float
    """No layout scores more than `score` + `gap`; 0 if the layout is proven the best, within `rounding_margin`."""
    regions: int
    """Regions that were bounded."""
    evaluations: int


@dataclass(order=True)
class _Region:
    """A set of layouts with an upper bound on their scores; the heap pops the largest bound first."""

    negative_bound: float
    number: int
    mask: Region = field(compare=False)
    """(sensors, candidates)."""
    weights: Floats = field(compare=False)
    """(sensors, candidates), summing to 1 in each row."""


def bound_gap(problem: Problem, layout: Indices) -> float:
    """Return by how much another layout could be better, from a single bound over all layouts; quick."""
    search = _Search(problem, layout)
    root = search.root()
    return search.stated_gap(root.negative_bound if root else np.inf)


def prove(
    problem: Problem,
    layout: Indices,
    max_regions: int | None = None,
    progress: Fraction = silent,
) -> Proof:
    """Prove a layout the best on the grid, or replace it by a better one, or bound the gap.

    Parameters
    ----------
    problem : the placement problem
    layout : the best known layout
    max_regions : number of regions to bound before the remaining gap is returned; about half a minute by default
    progress : called with the gap now and then
    """
    search = _Search(problem, layout)
    root = search.root()
    regions = [root] if root else []
    max_regions = max_regions or max(50, int(MAX_REGIONS * search.bounder.ease))
    while regions and -regions[0].negative_bound > search.limit and search.regions < max_regions:
        region = heapq.heappop(regions)
        progress(-region.negative_bound - search.score)
        if math.prod(region.mask.sum(axis=1).tolist()) <= ENUMERATED:
            search.enumerate(region.mask)
            continue
        for part in _split(region):
            tightened = search.tightened(part, region.weights, STEPS, -region.negative_bound)
            if tightened is not None:
                heapq.heappush(regions, tightened)
    gap = search.stated_gap(regions[0].negative_bound if regions else np.inf)
    return Proof(search.layout, search.score, gap, search.regions, search.evaluations)


def rounding_margin(problem: Problem, layout: Indices) -> float:
    """Return a bound on the rounding error of a bound or a score, in log units.

    Coordinates are off by some eps of the longest column, and a bound divides them by the smallest scored component.
    """
    singular = np.linalg.svd(problem.features[:, layout], compute_uv=False)
    ratio = singular[0] / max(singular[problem.leading - 1], np.finfo(np.float64).tiny)
    return max(MARGIN, 100 * problem.count * float(np.finfo(np.float64).eps * ratio))


class _Search:
    """The best layout so far, and the bounds of regions against it."""

    def __init__(self, problem: Problem, layout: Indices) -> None:
        self.problem = problem
        self.bounder: Bounder = bounder_of(problem)
        self.layout = layout
        self.score = problem.exact_score(layout)
        self.margin = rounding_margin(problem, layout)
        self.regions = 0
        self.evaluations = 0

    @property
    def limit(self) -> float:
        """The score that a layout must exceed to be better than the best so far."""
        return self.score + self.margin

    def stated_gap(self, negative_bound: float) -> float:
        """Return the excess of a bound over the best score: 0 if it is rounding, or the margin if that is large."""
        gap = max(-negative_bound - self.score, self.margin)
        return gap if gap > min(self.margin, LARGEST_MARGIN) else 0.0

    def root(self) -> _Region | None:
        """Return the region of all allowed layouts, without those that the bound excludes."""
        shape = (self.problem.count, len(self.problem.rules.position_mm))
        mask = np.isfinite(self.problem.rules.best_through(np.zeros(shape)))
        at_layout = np.zeros(shape)
        at_layout[np.arange(shape[0]), np.sort(self.layout)] = 1
        # The best known layout gives the best multiplier if the relaxation is tight, and a bad one if it is not.
        first = self.tightened(mask, at_layout, 1)
        if first is None or -first.negative_bound - self.score < 1e-2:
            return first
        spread = mask / mask.sum(axis=1, keepdims=True)
        second = self.tightened(first.mask, (at_layout + spread) / 2, max(10, int(ROOT_STEPS * self.bounder.ease)))
        return second and max(first, second)

    def tightened(self, mask: Region, weights: Floats, steps: int, known: float = np.inf) -> _Region | None:
        """Return a region with its bound, without the candidates that the bound excludes; None if nothing is left."""
        self.regions += 1
        weights = _within(mask, weights)
        bound, best, limit = known, weights, self.limit
        for _ in range(steps):
            found = self.bounder.bound(weights.sum(axis=0), mask)
            mask = mask & (found.through > limit)
            if found.value < bound:
                bound, best = found.value, weights
            if not mask.any(axis=1).all():
                return None
            weights = _within(mask, weights * found.price)
        return _Region(-bound, self.regions, mask, _within(mask, best))

    def enumerate(self, mask: Region) -> None:
        """Score every layout of a small region."""
        choices = np.meshgrid(*(np.flatnonzero(row) for row in mask), indexing="ij")
        layouts = np.stack([choice.ravel() for choice in choices], axis=1)
        layouts = layouts[np.all(np.diff(layouts, axis=1) > 0, axis=1)]
        self.evaluations += len(layouts)
        if not len(layouts):
            return
        scores = self.problem.scores(layouts)
        # The quick scores are accurate to 1e-7: layouts that may be the best are scored again to rounding.
        for index in np.flatnonzero(scores > max(float(scores.max()), self.score) - 1e-6):
            exact = self.problem.exact_score(layouts[index])
            if exact > self.limit:
                self.score, self.layout = exact, layouts[index]


def _within(mask: Region, weights: Floats) -> Floats:
    """Restrict weights to a region; each row sums to 1, and no weight inside is 0, so that it can grow again."""
    inside = np.where(mask, np.maximum(weights, FLOOR), 0.0)
    normal: Floats = inside / inside.sum(axis=1, keepdims=True)
    return normal


def _split(region: _Region) -> list[Region]:
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
