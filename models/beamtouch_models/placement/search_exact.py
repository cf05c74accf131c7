"""Exchange search: from several starts, repeats the best exchange of one sensor, then exchanges two at once.

When column i replaces column k of a layout, the squared volume spanned by its columns changes by the factor
b_ki^2 + |r_i|^2 |p_k|^2. Here b are the least-squares coefficients and r the remainder of column i on the layout, and
p_k is row k of the layout's pseudo-inverse. So all exchanges of a layout cost one matrix product (Fedorov, Theory of
Optimal Experiments, 1972, sec. 3.3).
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import combinations, pairwise

import numpy as np

from beamtouch_models.arrays import Floats, Indices
from beamtouch_models.placement.layout import Candidates
from beamtouch_models.placement.problem import Problem

RANDOM_STARTS = 2
LEADING_RANDOM_STARTS = 4
"""Random starts if fewer eigenvalues than sensors count: without the exchange formula, more runs end too early."""
MAX_EXCHANGES = 2_000
TINY = float(np.finfo(np.float64).tiny)
GAIN = 1e-10
"""Smallest gain, in log units, that exceeds rounding."""


@dataclass(frozen=True)
class SearchRun:
    """The result of a search from one start."""

    layout: Indices
    scores: tuple[float, ...]
    """Best score after each step, the start first."""
    evaluations: int

    @property
    def score(self) -> float:
        """Score of the found layout."""
        return self.scores[-1]


def exact_search(problem: Problem, seed: int) -> list[SearchRun]:
    """Return runs from equal pitch, the greedy layout and random layouts; the same seed gives the same runs."""
    rng = np.random.default_rng(seed)
    some = problem.leading < problem.count
    random_starts = LEADING_RANDOM_STARTS if some else RANDOM_STARTS
    starts = [*problem.starts, *(problem.random_layout(rng) for _ in range(random_starts))]
    if some:
        return [pattern_search(problem.scores, problem.rules, start) for start in starts]
    runs = [exchange(problem, start) for start in starts]
    best = int(np.argmax([run.score for run in runs]))
    runs[best] = _with_pairs(problem, runs[best])
    return runs


def first_best(runs: list[SearchRun]) -> SearchRun:
    """Return the best run; of runs that are equal within rounding, the first."""
    best = max(run.score for run in runs)
    return next(run for run in runs if run.score >= best - 1e-9)


def exchange(problem: Problem, start: Indices) -> SearchRun:
    """Make the best single exchange until none gains. Only for the product of all eigenvalues."""
    layout = np.sort(start)
    score, gains = _score_and_gains(problem, layout)
    scores, evaluations = [score], gains.size
    for _ in range(MAX_EXCHANGES):
        k, chosen = np.unravel_index(int(gains.argmax()), gains.shape)
        if not gains[k, chosen] > 0:  # the rules forbid every exchange, as where all sensors are fixed
            break
        changed = layout.copy()
        changed[k] = chosen
        changed.sort()
        score, gains = _score_and_gains(problem, changed)
        evaluations += gains.size
        # Decide by the score of the changed layout itself: near a singular layout, a gain is mostly rounding.
        if not score > scores[-1] + GAIN:
            break
        layout = changed
        scores.append(score)
    return SearchRun(layout, tuple(scores), evaluations)


def _score_and_gains(problem: Problem, layout: Indices) -> tuple[float, Floats]:
    """Return the score of a layout, and the change of the squared volume by each exchange (sensor, candidate).

    The change is a factor, 0 if a rule forbids the exchange.
    """
    features, rules = problem.features, problem.rules
    basis, triangle = np.linalg.qr(features[:, layout])
    diagonal = np.abs(np.diag(triangle))
    score = 2 * float(np.log(np.maximum(diagonal, TINY)).sum()) + problem.count * problem.offset
    # Columns that coincide within rounding get a tiny remainder, so that the triangle stays invertible.
    floor = (diagonal.max() or 1.0) * 1e-14
    triangle[np.diag_indices_from(triangle)] += np.where(diagonal <= floor, floor, 0.0)
    along = basis.T @ features
    remainder = features - basis @ along
    inverse = np.linalg.inv(triangle)
    squares = np.einsum("ij,ij->j", remainder, remainder)
    gains: Floats = (inverse @ along) ** 2 + squares * np.einsum("ij,ij->i", inverse, inverse)[:, None]
    near = rules.conflicts(layout)
    gains[(near.sum(axis=0) - near) > 0] = 0
    if len(rules.fixed):
        gains[rules.is_fixed(layout)] = 0
    return score, gains


def _with_pairs(problem: Problem, run: SearchRun) -> SearchRun:
    """Continue where single exchanges end: move one sensor or two at once, by one or two steps, until nothing gains."""
    return pattern_search(problem.scores, problem.rules, run.layout, step=2, before=run)


def pattern_search(
    score: Callable[[Indices], Floats],
    rules: Candidates,
    start: Indices,
    step: int | None = None,
    before: SearchRun | None = None,
) -> SearchRun:
    """Move one or two sensors by a step, keep the best move, and halve the step when nothing gains.

    Parameters
    ----------
    score : function that scores layouts (population, sensors), -inf where not allowed
    rules : rules of the scene; fixed sensors stay
    start : first layout
    step : first step, in candidates; a quarter of the mean pitch by default
    before : the run that led to `start`
    """
    layout = start
    scores = list(before.scores) if before else [float(score(start[None, :])[0])]
    evaluations = before.evaluations if before else 1
    step = step or max(1, len(rules.position_mm) // (4 * len(start)))
    while step:
        trials = np.array(list(_moved(layout, step, len(rules.position_mm), rules)), dtype=np.intp)
        values = score(trials) if len(trials) else np.array([-np.inf])
        evaluations += len(trials)
        best = int(values.argmax())
        if values[best] > scores[-1] + GAIN:
            layout = np.sort(trials[best])
            scores.append(float(values[best]))
        else:
            step //= 2
    return SearchRun(layout, tuple(scores), evaluations)


def _moved(layout: Indices, step: int, candidates: int, rules: Candidates) -> Iterator[Indices]:
    """Yield the allowed layouts with one or two sensors moved by a step; of many sensors, only neighbours as pairs."""
    free = np.flatnonzero(~rules.is_fixed(layout))
    pairs = combinations(free, 2) if len(free) <= 8 else pairwise(free)
    for sensors, signs in [
        *(((k,), (sign,)) for k in free for sign in (-1, 1)),
        *((pair, (one, other)) for pair in pairs for one in (-1, 1) for other in (-1, 1)),
    ]:
        moved = layout.copy()
        moved[list(sensors)] += step * np.array(signs)
        if moved.min() >= 0 and moved.max() < candidates and rules.allowed(moved[None, :])[0]:
            yield moved
