"""The paper's search: clone the best layout, vary the clones, keep the best, shrink the variation when nothing gains.

Scored in logarithms and over the whole population at once. What is added to the paper so that it reaches the optimum
from every seed: it starts anew from other layouts, and some of the clones move one sensor, or two, instead of all.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from beamtouch_models.layout import Candidates, Indices
from beamtouch_models.placement.problem import Problem
from beamtouch_models.placement.search_exact import GAIN, Run

Array = NDArray[np.float64]

RANDOM_STARTS = 2
LEADING_RANDOM_STARTS = 5
POPULATION = 36
"""At least; eight per sensor."""
MAX_GENERATIONS = 400
SHRINK = 0.6
PATIENCE = 5
"""Generations without a gain, at the smallest increment, that end a run."""


def paper_runs(problem: Problem, seed: int) -> list[Run]:
    """Runs from equal pitch, as in the paper, and from random layouts; the same seed gives the same runs."""
    rng = np.random.default_rng(seed)
    random_starts = LEADING_RANDOM_STARTS if problem.leading < problem.count else RANDOM_STARTS
    starts = [problem.starts[0], *(problem.random_layout(rng) for _ in range(random_starts))]
    return [paper_search(problem.scores, problem.rules, start, rng) for start in starts]


def paper_search(score: Callable[[Indices], Array], rules: Candidates, start: Indices, rng: np.random.Generator) -> Run:
    """One run of the paper's search.

    Parameters
    ----------
    score : of layouts (population, sensors), the larger the better, -inf where not allowed
    rules : of the scene; fixed sensors stay
    start : layout to begin with
    rng : of the variations
    """
    best, trail = start, [(float(score(start[None, :])[0]), start)]
    increment = len(rules.position_mm) / (2 * len(start))
    evaluations, idle = 1, 0
    while len(trail) < MAX_GENERATIONS and idle < PATIENCE:
        clones = _varied(best, rules, increment, rng)
        values = score(clones)
        evaluations += len(clones)
        winner = int(values.argmax())
        if values[winner] > trail[-1][0] + GAIN:
            best, idle = np.sort(clones[winner]), 0
            trail.append((float(values[winner]), best))
        else:
            idle += increment <= 0.5
            increment = max(increment * SHRINK, 0.5)
            trail.append((trail[-1][0], best))
    return Run(best, tuple(trail), evaluations)


def _varied(best: Indices, rules: Candidates, increment: float, rng: np.random.Generator) -> Indices:
    """Clones of a layout with random changes: a third in all sensors, a third in one, a third in two."""
    free = np.flatnonzero(~rules.is_fixed(best))
    population = max(POPULATION, 8 * len(best))
    clones = np.repeat(best[None, :], population, axis=0)
    if not len(free):
        return clones
    change = np.rint(rng.normal(scale=increment, size=(population, len(free)))).astype(np.intp)
    # In its turn a sensor moves by at least a step: a clone that is no other than its parent is wasted.
    change[change == 0] = rng.choice([-1, 1], size=int((change == 0).sum()))
    order = rng.permuted(np.tile(np.arange(len(free)), (population, 1)), axis=1)
    moving = np.resize([len(free), 1, min(2, len(free))], population)
    change[order >= moving[:, None]] = 0
    clones[:, free] = np.clip(clones[:, free] + change, 0, len(rules.position_mm) - 1)
    return clones
