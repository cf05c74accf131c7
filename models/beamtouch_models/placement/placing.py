"""Placement of sensors by a criterion and a search, with a proof where the criterion has a bound."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from beamtouch_models.accuracy.prior import SampleErrors
from beamtouch_models.arrays import Floats, Indices
from beamtouch_models.errors import SceneError
from beamtouch_models.physics.influence import InfluenceFunction
from beamtouch_models.placement.components import log_eigenvalue_product
from beamtouch_models.placement.layout import Candidates
from beamtouch_models.placement.position_error import Surrogate, decided, surrogate_of
from beamtouch_models.placement.problem import Problem, equal_layout, problem_of
from beamtouch_models.placement.proof import bound_gap, prove
from beamtouch_models.placement.search_exact import SearchRun, exact_search, first_best, pattern_search
from beamtouch_models.placement.search_paper import paper_runs, paper_search
from beamtouch_models.progress import Progress, silent
from beamtouch_models.sweeps import Spread, in_turn, one_thread

SearchName = Literal["exact", "paper"]
Certify = Literal["nothing", "bound", "proof"] | Spread

SURROGATE_STARTS = 2


@dataclass(frozen=True)
class Placement:
    """A layout, and the search that found it."""

    positions_mm: tuple[float, ...]
    """Ascending, from the left end."""
    log_eigenvalue_product: float
    """Natural logarithm of the product of the leading eigenvalues, with deflections per newton in the structure's
    `unit_mm_per_n`: for a beam, lengths in units of l and W/(EI) = 1. Minus infinity if rounding hides one of them,
    which can happen with the position-error criterion only."""
    evaluations: int
    """Number of layouts scored."""
    convergence: tuple[float, ...]
    """Best score after each step of the winning run: the logarithm above, or minus the mean position error in mm."""
    gap: float | None = None
    """No layout scores more than log_eigenvalue_product + gap. 0: proven the best; None: no bound is known."""

    @property
    def proven(self) -> bool:
        """Whether no layout on the grid scores more, within `proof.rounding_margin`."""
        return self.gap == 0


def place(
    influence: InfluenceFunction,
    rules: Candidates,
    count: int,
    seed: int,
    leading: int | None = None,
    *,
    search: SearchName = "exact",
    certify: Certify = "nothing",
    progress: Progress = silent,
) -> Placement:
    """Place sensors so that the product of the leading eigenvalues (eq. 4) is largest.

    Parameters
    ----------
    influence, rules : influence function of the structure, and rules for its sensors
    count : number of sensors
    seed : seed of the search
    leading : number of eigenvalues in the product; `count` by default
    search : "exact" exchanges sensors from many starts, "paper" clones and varies a layout
    certify : "bound" states a gap; "proof" closes it if possible, and may return a better layout; a `Spread` does the
        same as "proof" with the tasks that it runs
    progress : called with the current step and the fraction done

    Raises
    ------
    SceneError
        The rules allow no layout of `count` sensors, or no layout has `leading` components.
    """
    with one_thread():
        problem = problem_of(influence, rules, count, leading)
        progress("searching", 0.0)
        runs = _searched(problem, search, seed)
        best = first_best(runs)
        layout, score, evaluations, gap = best.layout, problem.exact_score(best.layout), _total(runs), None
        if not np.isfinite(score):
            message = f"the rules of sensors leave no {count} positions with independent readings; use fewer sensors"
            raise SceneError(message)
        if certify == "bound":
            progress("bounding", 0.5)
            gap = bound_gap(problem, layout)
        elif certify != "nothing":
            spread = in_turn if isinstance(certify, str) else certify
            proof = prove(
                problem, layout, progress=lambda left: progress(f"proving, gap {left:.2g}", 0.5), spread=spread
            )
            layout, score, gap, evaluations = proof.layout, proof.score, proof.gap, evaluations + proof.evaluations
    return _placement(rules, layout, score, best, evaluations, gap)


def place_by_position_error(
    influence: InfluenceFunction,
    rules: Candidates,
    count: int,
    seed: int,
    errors: SampleErrors,
    *,
    leading: int | None = None,
    search: SearchName = "exact",
    progress: Progress = silent,
) -> Placement:
    """Place sensors so that the accuracy limit is smallest; arguments and errors as `place`.

    `errors` are those of a sample; its noise must not be 0. This criterion has no bound, so the gap is None.
    """
    if not 0 < errors.noise_mm < np.inf:
        message = f"sensors: with a noise of {errors.noise_mm:g} mm all layouts are equal; state the noise of a reading"
        raise SceneError(message)
    with one_thread():
        equal = equal_layout(rules, influence.length_mm, count)
        surrogate = surrogate_of(influence, rules, count, errors, seed)
        starts = _surrogate_starts(influence, surrogate, equal, seed)
        rng = np.random.default_rng(seed)
        runs = []
        for number, start in enumerate(starts[:SURROGATE_STARTS]):
            progress("searching", 0.7 * number / SURROGATE_STARTS)
            if search == "paper":
                runs.append(paper_search(surrogate.scores, rules, start, rng))
            else:
                runs.append(pattern_search(surrogate.scores, rules, start))
        runs.sort(key=lambda run: -run.score)
        finalists = [*(run.layout for run in runs), *starts]
        layout = decided(influence, rules, finalists, errors, seed, lambda part: progress("deciding", 0.7 + 0.3 * part))
    positions = np.sort(rules.position_mm[layout])
    return _placement(rules, layout, score_positions(influence, positions, leading), runs[0], _total(runs), None)


def score_positions(influence: InfluenceFunction, positions_mm: Floats, leading: int | None = None) -> float:
    """Return the logarithm of the eigenvalue product of a layout, in the unit of `Placement.log_eigenvalue_product`."""
    score = float(log_eigenvalue_product(influence.matrix(positions_mm), leading))
    return score - 2 * (leading or len(positions_mm)) * float(np.log(influence.unit_mm_per_n))


def _searched(problem: Problem, search: SearchName, seed: int) -> list[SearchRun]:
    return exact_search(problem, seed) if search == "exact" else paper_runs(problem, seed)


def _surrogate_starts(influence: InfluenceFunction, surrogate: Surrogate, equal: Indices, seed: int) -> list[Indices]:
    """Return the layouts to start from, ordered by the surrogate with the best first."""
    starts = [equal, surrogate.cramer_rao_layout(equal)]
    try:
        problem = problem_of(influence, surrogate.rules, len(equal))
    except SceneError:
        pass  # With fewer components than sensors, there is no eigenvalue product to maximise.
    else:
        starts.append(first_best(exact_search(problem, seed)).layout)
    values = surrogate.scores(np.array(starts))
    return [starts[index] for index in np.argsort(-values, kind="stable")]


def _total(runs: list[SearchRun]) -> int:
    return sum(run.evaluations for run in runs)


def _placement(
    rules: Candidates, layout: Indices, score: float, run: SearchRun, evaluations: int, gap: float | None
) -> Placement:
    return Placement(tuple(np.sort(rules.position_mm[layout]).tolist()), score, evaluations, run.scores, gap)
