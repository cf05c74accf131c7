"""Placement by the mean position error: a quick surrogate searches, and the accuracy limit decides among the best.

Without a spare, only layouts count that notice loads other than one contact as well as the layout of the eigenvalue
product: the least error alone leaves little with which to notice them. With a spare, the layout that notices most is
taken of those whose error is hardly larger than the least.
"""

import math
from itertools import combinations, islice

import numpy as np

from beamtouch_models.accuracy.limit import accuracy_limit
from beamtouch_models.accuracy.prior import Prior, SampleErrors
from beamtouch_models.arrays import Floats, Indices
from beamtouch_models.errors import SceneError
from beamtouch_models.physics.influence import InfluenceFunction
from beamtouch_models.placement.goal import SLACK, TIE, Goal
from beamtouch_models.placement.layout import Candidates
from beamtouch_models.placement.most_noticing import MostNoticing
from beamtouch_models.placement.noticing import other_loads
from beamtouch_models.placement.position_error import Surrogate, surrogate_of
from beamtouch_models.placement.problem import equal_layout, problem_of
from beamtouch_models.placement.search_exact import SearchRun, exact_search, first_best
from beamtouch_models.placement.search_gains import first_gains
from beamtouch_models.placement.search_paper import SearchName, paper_search
from beamtouch_models.progress import Fraction

STARTS = 2
"""Layouts that a search starts from."""
FINALISTS = 6
"""Layouts of a list that the accuracy limit compares."""
CLEAR = 1.015
"""Ratio of two scores from which they decide without the accuracy limit. The ratio of score to limit scatters by 0.2 to
0.6 % between layouts, and a limit of FINAL_DRAWS contacts by as much."""
FINAL_DRAWS = 2_000
"""Simulated contacts by which the finalists are compared; fewer with a spare and many sensors."""
MAX_LOOKED_AT = 2_000
"""Layouts that a run looks at, after which it tries no smaller step; up to eight sensors seldom need as many."""
MAX_LIMITS = 5
"""A finalist has an accuracy limit with all sensors and, with a spare, one for each failed sensor. Up to this many
limits have FINAL_DRAWS contacts each; more of them share that total, which bounds the time."""
MAX_LISTED = 512
"""Up to this many layouts are all scored, which takes no longer than a search."""
MAX_EXCHANGES = 200
"""Exchanges of one sensor, after which the layout of the Cramer-Rao bound is taken as it is."""


def searched(
    influence: InfluenceFunction,
    rules: Candidates,
    count: int,
    seed: int,
    errors: SampleErrors,
    *,
    spare: int,
    search: SearchName,
    progress: Fraction,
) -> tuple[Indices, list[SearchRun]]:
    """Return the layout with the least mean error, and the runs that found that error, the best first.

    Arguments and errors as `placing.place_by_position_error`.
    """
    equal = equal_layout(rules, influence.length_mm, count)
    reference = _by_product(influence, rules, equal, seed)
    surrogate = surrogate_of(influence, rules, equal, errors, seed)
    others = other_loads(influence, rules, errors)
    # Sensors that replace each other leave little with which to notice: a spare that had to would be worth nothing.
    goal = Goal(surrogate, spare, others, None if spare else others.noticed(reference) - SLACK)
    if math.comb(len(rules.position_mm), count) <= MAX_LISTED:
        best, evaluations = _listed(goal, count)
        runs = [SearchRun(best[0], (-goal.scored(best[0]).objective,), evaluations)]
    else:
        plain = goal.towards(reference, equal)
        runs = _runs(goal, _starts(goal, reference, plain, equal), search, seed, lambda part: progress(0.7 * part))
        best = [runs[0].layout, plain]
    # The reference is among them, so that the error is no larger than that of the eigenvalue product.
    finalists = _finalists(goal, [*best, reference])
    found = _decided(influence, rules, finalists, errors, seed, spare, lambda part: progress(0.7 + 0.3 * part))
    return (first_gains(MostNoticing.near(goal, found), found, MAX_LOOKED_AT).layout if spare else found), runs


def mean_errors_percent(
    influence: InfluenceFunction,
    positions_mm: Floats,
    errors: SampleErrors,
    draws: int,
    seed: int,
    spare: int = 0,
) -> list[float]:
    """Return the accuracy limit of a layout in percent: with all sensors, and with a spare, with each one failed."""
    prior = Prior.real(influence, positions_mm, errors)
    priors = [prior, *(prior.without(index) for index in range(prior.channels if spare else 0))]
    return [accuracy_limit(one, draws, seed).percent for one in priors]


def objective(all_percent: float, failed_percent: list[float]) -> float:
    """Return what a placement minimises: the largest error with one failed; among equals, that with all sensors."""
    return max(failed_percent) + TIE * all_percent if failed_percent else all_percent


def draws_of(count: int, spare: int) -> int:
    """Return the number of contacts for each accuracy limit of a finalist with this many sensors."""
    return round(FINAL_DRAWS * min(1.0, MAX_LIMITS / (1 + spare * count)))


def _runs(goal: Goal, starts: list[Indices], search: SearchName, seed: int, progress: Fraction) -> list[SearchRun]:
    """Return the runs from each start, the best first."""
    rng, runs = np.random.default_rng(seed), []
    for number, start in enumerate(starts):
        progress(number / len(starts))
        if search == "paper":
            runs.append(paper_search(goal.scores, goal.surrogate.rules, start, rng))
        else:
            runs.append(first_gains(goal, start, MAX_LOOKED_AT))
    return sorted(runs, key=lambda run: -run.score)


def _listed(goal: Goal, count: int) -> tuple[list[Indices], int]:
    """Return the best of all layouts, the best first, and how many there are."""
    rules = goal.surrogate.rules
    every = np.array(list(combinations(range(len(rules.position_mm)), count)), dtype=np.intp)
    layouts = sorted(every[rules.allowed(every)], key=lambda layout: goal.scored(layout).objective)
    return list(islice(filter(goal.notices_enough, layouts), FINALISTS)), len(every)


def _finalists(goal: Goal, layouts: list[Indices]) -> list[Indices]:
    """Return the distinct layouts whose scores do not differ clearly from the best, the best first."""
    scored = sorted((goal.scored(layout) for layout in layouts), key=lambda one: one.objective)
    near = [one.layout for one in scored if one.objective <= CLEAR * scored[0].objective]
    return _distinct(near)


def _distinct(layouts: list[Indices]) -> list[Indices]:
    return list({tuple(layout): layout for layout in layouts}.values())


def _by_product(influence: InfluenceFunction, rules: Candidates, equal: Indices, seed: int) -> Indices:
    """Return the layout of the eigenvalue product, or equal pitch if there are fewer components than sensors."""
    try:
        problem = problem_of(influence, rules, len(equal))
    except SceneError:
        return equal
    return np.sort(first_best(exact_search(problem, seed)).layout)


def _starts(goal: Goal, reference: Indices, plain: Indices, equal: Indices) -> list[Indices]:
    """Return the layouts to start from, the best first."""
    starts = [reference, plain, goal.towards(reference, cramer_rao_layout(goal.surrogate, equal))]
    return _distinct(sorted(starts, key=lambda layout: goal.scored(layout).objective))[:STARTS]


def cramer_rao_layout(surrogate: Surrogate, start: Indices) -> Indices:
    """Return the layout that single exchanges by the Cramer-Rao bound reach from `start`."""
    rules, terms = surrogate.rules, surrogate.information
    layout, value = start, float(surrogate.cramer_rao_mm(terms[:, :, start].sum(axis=2)))
    for _ in range(MAX_EXCHANGES):
        near, fixed = rules.conflicts(layout), rules.is_fixed(layout)
        trials = []
        for k in np.flatnonzero(~fixed):
            others = np.delete(layout, k)
            values = surrogate.cramer_rao_mm(terms[:, :, others].sum(axis=2)[:, :, None] + terms)
            values[np.delete(near, k, axis=0).any(axis=0)] = np.inf
            trials.append((float(values.min()), int(k), int(values.argmin())))
        best = min(trials, default=(np.inf, 0, 0))
        if not best[0] < value * (1 - 1e-9):
            break
        value, layout = best[0], np.sort(np.append(np.delete(layout, best[1]), best[2]))
    return layout


def _decided(
    influence: InfluenceFunction,
    rules: Candidates,
    layouts: list[Indices],
    errors: SampleErrors,
    seed: int,
    spare: int,
    progress: Fraction,
) -> Indices:
    """Return the layout with the smallest objective by the accuracy limit itself."""
    if len(layouts) == 1:
        return layouts[0]
    found, draws = [], draws_of(len(layouts[0]), spare)
    for number, layout in enumerate(layouts):
        progress(number / len(layouts))
        whole, *failed = mean_errors_percent(influence, rules.position_mm[layout], errors, draws, seed, spare)
        found.append(objective(whole, failed))
    return layouts[int(np.argmin(found))]
