"""The searches for a layout: exchange by steps, and the paper's. Each takes any objective.

The exchange moves one sensor or two by a step along an axis, takes a gain where it finds one, and halves the step when
no move gains. Steps do not lead over a support, beside which no sensor sees much; so at the end, from the best of all
starts, it tries each sensor at places all over the structure, and goes on from a gain.
The paper's search clones the best layout, varies the clones, keeps the best, and varies less when nothing gains. Its
scores are logarithms here. Two additions make it reach the optimum from every seed: it begins from several layouts, and
some clones move one or two sensors instead of all.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise
from typing import Protocol

import numpy as np

from beamtouch_models.arrays import Floats, Indices
from beamtouch_models.design.effort import USUAL, Effort
from beamtouch_models.design.placement.layout_rules import LayoutRules
from beamtouch_models.design.sweeps import Fraction, silent
from beamtouch_models.names import SearchName
from beamtouch_models.places import along_axis

MAX_EVALUATIONS = 2_000
"""Usual number of layouts, times `Objective.at_once`, after which an exchange tries no smaller step: it bounds the time
of many sensors."""
JUMPS = 24
"""Places over the structure at which each sensor is tried once no step gains, about."""
NEAR = 64
"""Part of the structure by which a refinement moves sensors at first."""
MAX_PAIRS_OF = 8
"""Number of sensors up to which any two move at once; of more, only neighbours."""
POPULATION = 36
"""Smallest number of clones; more sensors get eight clones each."""
MAX_GENERATIONS = 400
SHRINK = 0.6
PATIENCE = 5
"""Generations without a gain at the smallest increment after which the paper's search ends."""
GAIN = 1e-10
"""Smallest gain, relative to the score, that exceeds rounding."""


class Objective(Protocol):
    """The objective, which a search makes largest."""

    @property
    def rules(self) -> LayoutRules:
        """The rules that layouts keep."""

    @property
    def at_once(self) -> int:
        """Number of layouts that are best scored together: one if a score is costly."""

    def scores(self, layouts: Indices, above: float = -np.inf, /) -> Floats:
        """Score layouts (population, sensors), each ascending; -inf where one is not allowed.

        A layout that does not score more than `above` may have any score up to it.
        """


@dataclass(frozen=True)
class SearchRun:
    """The result of a search from one start."""

    layouts: tuple[Indices, ...]
    """Best layout (sensors,), ascending, after each step, the start first."""
    scores: tuple[float, ...]
    """Their scores."""
    evaluations: int

    @property
    def layout(self) -> Indices:
        """The found layout."""
        return self.layouts[-1]

    @property
    def score(self) -> float:
        """Score of the found layout."""
        return self.scores[-1]


def refine(objective: Objective, layout: Indices, most: int, step: int | None = None) -> SearchRun:
    """Move the sensors of an allowed layout (sensors,) while it gains, at first by a step in places, by default small.

    After `most` layouts it tries no smaller step.
    """
    first = SearchRun((layout,), (float(objective.scores(layout[None])[0]),), 1)
    return _by_steps(objective, first, most, step or near_steps(objective.rules))


def near_steps(rules: LayoutRules) -> int:
    """Return how many places a refinement moves a sensor at first."""
    return max(1, rules.ticks_across // NEAR)


def search_from(
    starts: Sequence[Indices],
    objective: Objective,
    search: SearchName,
    seed: int,
    progress: Fraction = silent,
    effort: Effort = USUAL,
    finest: int = 1,
) -> list[SearchRun]:
    """Return a run from each allowed start (sensors,), of which there is one at least; a seed gives the same runs.

    `finest` is the smallest step of an exchange, in places.
    """
    rng, runs = np.random.default_rng(seed), []
    most = effort.of(MAX_EVALUATIONS) * objective.at_once
    layouts = np.sort(np.array(starts), axis=1)
    distinct = np.sort(np.unique(layouts, axis=0, return_index=True)[1])
    for number, layout in enumerate(layouts[distinct]):
        progress(number / len(distinct))
        score = float(objective.scores(layout[None])[0])
        if score > -np.inf:
            run, by_steps = SearchRun((layout,), (score,), 1), search == "exchange"
            runs.append(_walk(objective, run, most, finest) if by_steps else paper_search(objective, run, rng))
    if search == "exchange":
        best = max(range(len(runs)), key=lambda number: runs[number].score)
        runs[best] = jump(objective, runs[best], most, finest)
    return runs


def first_best(runs: Sequence[SearchRun]) -> SearchRun:
    """Return the best run; of runs that are equal within rounding, the first."""
    best = max(run.score for run in runs)
    return next(run for run in runs if run.score >= best - 1e-9 * abs(best))


def jump(objective: Objective, run: SearchRun, most: int, finest: int = 1) -> SearchRun:
    """Try each sensor all over the structure, and go on by steps from the largest gain, until there is none.

    It begins no such round after `most` layouts, beside those that the run has scored before.
    """
    count, places, before = len(run.layout), objective.rules.evenly(JUMPS), run.evaluations
    while run.evaluations < before + most:
        trials = np.repeat(run.layout[None, :], len(places) * count, axis=0)
        trials[np.arange(len(trials)), np.repeat(np.arange(count), len(places))] = np.tile(places, count)
        trials = np.sort(trials, axis=1)
        best, best_score = run.layout, run.score
        for first in range(0, len(trials), objective.at_once):
            tried = trials[first : first + objective.at_once]
            values = objective.scores(tried, best_score)
            winner = int(values.argmax())
            if _gains(values[winner], best_score):
                best, best_score = tried[winner], float(values[winner])
        evaluations = run.evaluations + len(trials)
        if best_score == run.score:
            return SearchRun(run.layouts, run.scores, evaluations)
        run = SearchRun((*run.layouts, best), (*run.scores, best_score), evaluations)
        run = _walk(objective, run, before + most, finest)
    return run


def _walk(objective: Objective, run: SearchRun, most: int, finest: int) -> SearchRun:
    """Move sensors by steps, at first by a quarter of the distance that equal pitch has."""
    axes = objective.rules.axes
    step = max(1, objective.rules.ticks_across // (4 * along_axis(len(run.layout), axes)))
    return _by_steps(objective, run, most, step, finest)


def _by_steps(objective: Objective, run: SearchRun, most: int, step: int, finest: int = 1) -> SearchRun:
    """Move one sensor or two by a step, on and on while it gains, and halve the step when no move does.

    After `most` layouts it tries no smaller step.
    """
    layouts, scores, evaluations = list(run.layouts), list(run.scores), run.evaluations
    rules, group, sensors = objective.rules, objective.at_once, len(run.layout)
    moves = _moves(sensors, rules.axes)
    untried = len(moves)
    while step >= finest and evaluations < most:
        # Of another round, only moves before the last that gained: the others have been tried from there.
        rest, untried = untried, 0
        for first in range(0, rest, group):
            tried = moves[first : first + group]
            while len(tried):
                trials = np.sort(rules.moved(layouts[-1], step * tried), axis=1)
                inside = trials[:, 0] >= 0
                trials, tried = trials[inside], tried[inside]
                values = objective.scores(trials, scores[-1])
                evaluations += len(trials)
                best = int(values.argmax()) if len(values) else -1
                if best < 0 or not _gains(values[best], scores[-1]):
                    break
                tried = tried[best : best + 1]
                layouts.append(trials[best])
                scores.append(float(values[best]))
                untried = first + group - 1
        if not untried:
            step, untried = step // 2, len(moves)
    return SearchRun(tuple(layouts), tuple(scores), evaluations)


def paper_search(objective: Objective, run: SearchRun, rng: np.random.Generator) -> SearchRun:
    """Run the paper's search; `rng` draws the variations."""
    layouts, scores, evaluations = list(run.layouts), list(run.scores), run.evaluations
    rules = objective.rules
    increment, idle = rules.ticks_across / (2 * along_axis(len(run.layout), rules.axes)), 0
    while len(scores) < MAX_GENERATIONS and idle < PATIENCE:
        clones = _varied(layouts[-1], rules, increment, rng)
        values = objective.scores(clones, scores[-1])
        evaluations += len(clones)
        winner = int(values.argmax())
        if _gains(values[winner], scores[-1]):
            idle = 0
            layouts.append(clones[winner])
            scores.append(float(values[winner]))
        else:
            idle += increment <= 0.5
            increment = max(increment * SHRINK, 0.5)
            layouts.append(layouts[-1])
            scores.append(scores[-1])
    return SearchRun(tuple(layouts), tuple(scores), evaluations)


def _gains(score: float, before: float) -> bool:
    return score > before + GAIN * abs(before)


def _moves(count: int, axes: int) -> Indices:
    """Return the moves (moves, sensors, axes) of one sensor and of two, by one step to either side along an axis."""
    steps = [np.eye(axes, dtype=np.intp)[axis] * sign for axis in range(axes) for sign in (-1, 1)]
    alone = [[_move(count, {sensor: step}) for step in steps] for sensor in range(count)]
    pairs = combinations(range(count), 2) if count <= MAX_PAIRS_OF else pairwise(range(count))
    in_pairs = [
        _move(count, {pair[0]: first, pair[1]: second}) for pair in pairs for first in steps for second in steps
    ]
    return np.array([*(move for moves in alone for move in moves), *in_pairs])


def _move(count: int, steps: dict[int, Indices]) -> Indices:
    """Return the move (sensors, axes) of the sensors that take steps."""
    return np.array([steps.get(sensor, np.zeros_like(next(iter(steps.values())))) for sensor in range(count)])


def _varied(best: Indices, rules: LayoutRules, increment: float, rng: np.random.Generator) -> Indices:
    """Return clones of a layout with random moves: a third move all sensors, a third one, a third two."""
    free = np.flatnonzero(~np.isin(best, rules.fixed))
    population = max(POPULATION, 8 * len(best))
    clones = np.repeat(best[None, :], population, axis=0)
    if not len(free):
        return clones
    change = np.rint(rng.normal(scale=increment, size=(population, len(free), rules.axes))).astype(np.intp)
    # A sensor that is to move takes at least one step along an axis: a clone equal to its parent is wasted.
    still = np.argwhere(~change.any(axis=2))
    axis = rng.integers(rules.axes, size=len(still)) if rules.axes > 1 else 0
    change[still[:, 0], still[:, 1], axis] = rng.choice([-1, 1], size=len(still))
    order = rng.permuted(np.tile(np.arange(len(free)), (population, 1)), axis=1)
    moving = np.resize([len(free), 1, min(2, len(free))], population)
    change[order >= moving[:, None]] = 0
    clones[:, free] = rules.pushed(best[free], change)
    return np.sort(clones, axis=1)
