"""The search for a goal whose scores are costly: it takes each gain at once, and scores only what may gain."""

from itertools import combinations, pairwise
from typing import Protocol

import numpy as np

from beamtouch_models.arrays import Indices
from beamtouch_models.placement.goal import Scored
from beamtouch_models.placement.search_exact import SearchRun

MAX_PAIRS_OF = 8
"""Number of sensors up to which any two move at once; of more, only neighbours."""


class Wanted(Protocol):
    """What a search makes least; see `Goal`."""

    @property
    def candidates(self) -> int:
        """Number of places for a sensor."""

    def scored(self, layout: Indices) -> Scored:
        """Score a layout (sensors,)."""

    def better(self, layout: Indices, than: Scored) -> Scored | None:
        """Score a layout (sensors,) if it is allowed and better than another."""


def first_gains(goal: Wanted, start: Indices, most: float) -> SearchRun:
    """Move one or two sensors by a step, on and on while it gains, and halve the step when no move does.

    Parameters
    ----------
    goal : the quantity that is minimised
    start : first layout, allowed
    most : number of layouts looked at, after which no further step is tried
    """
    candidates = goal.candidates
    best = goal.scored(start)
    scores, evaluations = [-best.objective], 1
    step, moves = max(1, candidates // (4 * len(start))), _moves(len(start))
    while step and evaluations < most:
        before = best
        for move in moves:
            moved = best.layout + step * move
            while moved.min() >= 0 and moved.max() < candidates:
                evaluations += 1
                found = goal.better(moved, best)
                if found is None:
                    break
                best, moved = found, found.layout + step * move
                scores.append(-best.objective)
        if best is before:
            step //= 2
    return SearchRun(best.layout, tuple(scores), evaluations)


def _moves(count: int) -> list[Indices]:
    """Return the moves (sensors,) of one sensor and of two, by one step to either side."""
    unit = np.eye(count, dtype=np.intp)
    pairs = combinations(unit, 2) if count <= MAX_PAIRS_OF else pairwise(unit)
    return [
        *(sign * one for one in unit for sign in (-1, 1)),
        *(a * one + b * other for one, other in pairs for a in (-1, 1) for b in (-1, 1)),
    ]
