"""Branch and bound: proves that a layout is the best on the grid, or bounds how much better another could be.

It goes in rounds: the regions with the largest bounds are explored side by side, all against the best score so far. A
round has the same regions wherever they are explored, so a proof does not depend on the number of workers.
"""

import heapq
from dataclasses import dataclass

import numpy as np

from beamtouch_models.arrays import Indices
from beamtouch_models.placement.bound import bounder_of
from beamtouch_models.placement.problem import Problem
from beamtouch_models.placement.regions import MARGIN, Exploration, Explored, Region, explored, tightened
from beamtouch_models.progress import Fraction, silent
from beamtouch_models.sweeps import Spread, in_turn

MAX_MARGIN = 1e-6
"""With a larger margin, no layout counts as proven."""
MAX_REGIONS = 3_000
ROUND = 32
"""Most regions of a round. More keep more workers busy; fewer let a better layout exclude more regions."""
EASY = 64
"""A proof of up to this many regions is over before workers would have begun."""
ROOT_STEPS = 150


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


def bound_gap(problem: Problem, layout: Indices) -> float:
    """Return by how much another layout could be better, from a single bound over all layouts; quick."""
    search = _Search(problem, layout)
    root = search.root()
    return search.stated_gap(root.bound if root else -np.inf)


def prove(
    problem: Problem,
    layout: Indices,
    max_regions: int | None = None,
    progress: Fraction = silent,
    spread: Spread = in_turn,
) -> Proof:
    """Prove a layout the best on the grid, or replace it by a better one, or bound the gap.

    Parameters
    ----------
    problem : the placement problem
    layout : the best known layout
    max_regions : number of regions to bound before the remaining gap is returned; about half a minute by default
    progress : called with the gap after each round
    spread : runs the tasks of a round, one per region
    """
    search = _Search(problem, layout)
    root = search.root()
    if root is not None:
        search.push(root)
    max_regions = max_regions or max(50, int(MAX_REGIONS * search.bounder.ease))
    while search.regions < max_regions:
        # Each region is split into two.
        taken = search.taken(min(ROUND, -(-(max_regions - search.regions) // 2)))
        if not taken:
            break
        progress(taken[0].bound - search.score)
        tasks = [Exploration(search.bounder, region, search.score, search.limit) for region in taken]
        for found in (spread if search.regions > EASY and len(tasks) > 1 else in_turn)(explored, tasks):
            search.add(found)
    return Proof(search.layout, search.score, search.stated_gap(search.bound), search.regions, search.evaluations)


def rounding_margin(problem: Problem, layout: Indices) -> float:
    """Return a bound on the rounding error of a bound or a score, in log units.

    Coordinates are off by some eps of the longest column, and a bound divides them by the smallest scored component.
    """
    singular = np.linalg.svd(problem.features[:, layout], compute_uv=False)
    ratio = singular[0] / max(singular[problem.leading - 1], np.finfo(np.float64).tiny)
    return max(MARGIN, 100 * problem.count * float(np.finfo(np.float64).eps * ratio))


class _Search:
    """The best layout so far, and the open regions."""

    def __init__(self, problem: Problem, layout: Indices) -> None:
        self.problem = problem
        # Without the matrix, which is large; only an exact score needs it.
        self.bounder = bounder_of(problem.without_matrix)
        self.layout = layout
        self.score = problem.exact_score(layout)
        self.margin = rounding_margin(problem, layout)
        self.regions = 0
        self.evaluations = 0
        self._open: list[tuple[float, int, Region]] = []
        self._pushed = 0

    @property
    def limit(self) -> float:
        """The score that a layout must exceed to be better than the best so far."""
        return self.score + self.margin

    @property
    def bound(self) -> float:
        """The largest bound of an open region, minus infinity if there is none."""
        return -self._open[0][0] if self._open else -np.inf

    def push(self, region: Region) -> None:
        """Add an open region."""
        self._pushed += 1
        heapq.heappush(self._open, (-region.bound, self._pushed, region))

    def taken(self, most: int) -> list[Region]:
        """Remove and return the open regions with the largest bounds, largest first, that may hold a better layout."""
        found: list[Region] = []
        while len(found) < most and self.bound > self.limit:
            found.append(heapq.heappop(self._open)[2])
        return found

    def add(self, found: Explored) -> None:
        """Take over what the exploration of a region found."""
        self.regions += found.bounded
        self.evaluations += found.evaluations
        for region in found.parts:
            self.push(region)
        for layout in found.layouts:
            score = self.problem.exact_score(layout)
            if score > self.limit:
                self.score, self.layout = score, layout

    def stated_gap(self, bound: float) -> float:
        """Return the excess of a bound over the best score: 0 if it is rounding, or the margin if that is large."""
        gap = max(bound - self.score, self.margin)
        return gap if gap > min(self.margin, MAX_MARGIN) else 0.0

    def root(self) -> Region | None:
        """Return the region of all allowed layouts, without those that the bound excludes."""
        shape = (self.problem.count, len(self.problem.rules.position_mm))
        mask = np.isfinite(self.problem.rules.best_through(np.zeros(shape)))
        at_layout = np.zeros(shape)
        at_layout[np.arange(shape[0]), np.sort(self.layout)] = 1
        # The best known layout gives the best multiplier if the relaxation is tight, and a bad one if it is not.
        self.regions += 1
        first = tightened(self.bounder, mask, at_layout, 1, self.limit)
        if first is None or first.bound - self.score < 1e-2:
            return first
        spread = mask / mask.sum(axis=1, keepdims=True)
        steps = max(10, int(ROOT_STEPS * self.bounder.ease))
        self.regions += 1
        second = tightened(self.bounder, first.mask, (at_layout + spread) / 2, steps, self.limit)
        return second and min(first, second, key=lambda region: region.bound)
