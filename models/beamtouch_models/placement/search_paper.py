"""The paper's search: clone the best layout, vary the clones, keep the best, shrink the variation when nothing gains.

Scores are logarithms, computed for the whole population at once. Two additions to the paper make it reach the optimum
from every seed: it restarts from other layouts, and some clones move one or two sensors instead of all.
"""

from collections.abc import Callable
from typing import Literal

import numpy as np

from beamtouch_models.arrays import Floats, Indices
from beamtouch_models.placement.layout import Candidates
from beamtouch_models.placement.problem import Problem
from beamtouch_models.placement.search_exact import GAIN, SearchRun

SearchName = Literal["exact", "paper"]
"""The search of this file, and that of `search_exact`."""

RANDOM_STARTS = 2
LEADING_RANDOM_STARTS = 5
POPULATION = 36
"""Smallest number of clones; more sensors get eight clones each."""
MAX_GENERATIONS = 400
SHRINK = 0.6
PATIENCE = 5
"""Generations without a gain at the smallest increment after which a run ends."""


def paper_runs(problem: Problem, seed: int) -> list[SearchRun]:
    """Return runs from equal pitch, as in the paper, and from random layouts; the same seed gives the same runs."""
    rng = np.random.default_rng(seed)
    random_starts = LEADING_RANDOM_STARTS if problem.leading < problem.count else RANDOM_STARTS
    starts = [problem.starts[0], *(problem.random_layout(rng) for _ in range(random_starts))]
    return [paper_search(problem.scores, problem.rules, start, rng) for start in starts]


def paper_search(
    score: Callable[[Indices], Floats], rules: Candidates, start: Indices, rng: np.random.Generator
) -> SearchRun:
    """Run the paper's search once.

    Parameters
    ----------
    score : function that scores layouts (population, sensors), larger is better, -inf where not allowed
    rules : rules of the scene; fixed sensors stay
    start : first layout
    rng : random generator of the variations
    """
    best, scores = start, [float(score(start[None, :])[0])]
    increment = len(rules.position_mm) / (2 * len(start))
    evaluations, idle = 1, 0
    while len(scores) < MAX_GENERATIONS and idle < PATIENCE:
        clones = _varied(best, rules, increment, rng)
        values = score(clones)
        evaluations += len(clones)
        winner = int(values.argmax())
        if values[winner] > scores[-1] + GAIN:
            best, idle = np.sort(clones[winner]), 0
            scores.append(float(values[winner]))
        else:
            idle += increment <= 0.5
            increment = max(increment * SHRINK, 0.5)
            scores.append(scores[-1])
    return SearchRun(best, tuple(scores), evaluations)


def _varied(best: Indices, rules: Candidates, increment: float, rng: np.random.Generator) -> Indices:
    """Return clones of a layout with random moves: a third move all sensors, a third one, a third two."""
    free = np.flatnonzero(~rules.is_fixed(best))
    population = max(POPULATION, 8 * len(best))
    clones = np.repeat(best[None, :], population, axis=0)
    if not len(free):
        return clones
    change = np.rint(rng.normal(scale=increment, size=(population, len(free)))).astype(np.intp)
    # A sensor that is to move takes at least one step: a clone equal to its parent is wasted.
    change[change == 0] = rng.choice([-1, 1], size=int((change == 0).sum()))
    order = rng.permuted(np.tile(np.arange(len(free)), (population, 1)), axis=1)
    moving = np.resize([len(free), 1, min(2, len(free))], population)
    change[order >= moving[:, None]] = 0
    clones[:, free] = np.clip(clones[:, free] + change, 0, len(rules.position_mm) - 1)
    return clones
