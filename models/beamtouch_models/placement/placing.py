"""Placement of sensors by a criterion and a search, with a proof where the criterion has a bound."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from beamtouch_models.accuracy.prior import SampleErrors
from beamtouch_models.arrays import Floats, Indices
from beamtouch_models.errors import NotGoodEnoughError, SceneError
from beamtouch_models.physics.influence import InfluenceFunction
from beamtouch_models.placement.components import log_eigenvalue_product
from beamtouch_models.placement.layout import Candidates
from beamtouch_models.placement.least_error import searched
from beamtouch_models.placement.problem import Problem, problem_of
from beamtouch_models.placement.proof import bound_gap, prove
from beamtouch_models.placement.search_exact import SearchRun, exact_search, first_best
from beamtouch_models.placement.search_paper import SearchName, paper_runs
from beamtouch_models.progress import Progress, silent
from beamtouch_models.sweeps import Spread, in_turn, one_thread

AT_REST = 1e-12
"""Largest deflection at a support, over that elsewhere: rounding."""

Certify = Literal["nothing", "bound", "proof"] | Spread


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
    spare: int = 0,
    search: SearchName = "exact",
    progress: Progress = silent,
) -> Placement:
    """Place sensors so that the mean position error is least of layouts that notice other loads; as `place`.

    The mean position error is the accuracy limit with all errors of a sample: the mean, over contacts drawn uniformly
    from the ranges of position and force, of the distance between the contact and the posterior median.

    With `spare` = 0 the error with all sensors is minimised among the layouts that notice two contacts and spread loads
    as well as the layout of the eigenvalue product, within `goal.SLACK`. With `spare` = 1 it is the largest, over each
    one sensor failed, of the error of the others, among all layouts; of those within `most_noticing.PRICE` of the
    least, the one that notices most is taken.

    `errors` are those of a sample; its noise must not be 0. This criterion has no bound, so the gap is None. SceneError
    also if a sensor stands on a support.
    """
    if not 0 < errors.noise_mm < np.inf:
        message = f"sensors: with a noise of {errors.noise_mm:g} mm all layouts are equal; state the noise of a reading"
        raise SceneError(message)
    if count <= spare:
        message = f"--spare {spare} needs at least {spare + 1} sensors, not {count}; use --sensors, or sensors.count"
        raise SceneError(message)
    with one_thread():
        layout, runs = searched(
            influence,
            rules,
            count,
            seed,
            errors,
            spare=spare,
            search=search,
            progress=lambda part: progress("placing by position error", part),
        )
    positions = np.sort(rules.position_mm[layout])
    size = np.abs(influence.matrix(positions)).max(axis=0)
    if size.min() <= AT_REST * size.max():
        message = f"sensors: nothing moves at {positions[size.argmin()]:g} mm; move that sensor, or use fewer sensors"
        raise SceneError(message)
    return _placement(rules, layout, score_positions(influence, positions), runs[0], _total(runs), None)


def score_positions(influence: InfluenceFunction, positions_mm: Floats, leading: int | None = None) -> float:
    """Return the logarithm of the eigenvalue product of a layout, in the unit of `Placement.log_eigenvalue_product`."""
    score = float(log_eigenvalue_product(influence.matrix(positions_mm), leading))
    return score - 2 * (leading or len(positions_mm)) * float(np.log(influence.unit_mm_per_n))


def _searched(problem: Problem, search: SearchName, seed: int) -> list[SearchRun]:
    return exact_search(problem, seed) if search == "exact" else paper_runs(problem, seed)


def _total(runs: list[SearchRun]) -> int:
    return sum(run.evaluations for run in runs)


def _placement(
    rules: Candidates, layout: Indices, score: float, run: SearchRun, evaluations: int, gap: float | None
) -> Placement:
    """Return the result of every placement, after a last look at the rules; NotGoodEnoughError if it breaks one."""
    positions_mm = tuple(np.sort(rules.position_mm[layout]).tolist())
    if not rules.allowed(layout[None, :])[0]:
        places = ", ".join(f"{position:g}" for position in positions_mm)
        message = f"the search ended at {places} mm, against the rules of sensors; please report this scene as a defect"
        raise NotGoodEnoughError(message)
    return Placement(positions_mm, score, evaluations, run.scores, gap)
