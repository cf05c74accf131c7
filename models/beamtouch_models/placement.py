"""The paper's search for sensor positions: clone the best layout, vary it, shrink the variation when nothing is gained.

Scored by the logarithm of eq. 4, vectorised over the population, and started anew from several layouts.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beamtouch_models.beam import influence, load_positions_mm
from beamtouch_models.components import log_eigenvalue_product
from beamtouch_models.errors import SceneError
from beamtouch_models.layout import Candidates, Indices, candidates, equal_pitch_mm
from beamtouch_models.scene import Scene

Array = NDArray[np.float64]

POPULATION = 40
RESTARTS = 4
MAX_GENERATIONS = 200


@dataclass(frozen=True)
class Placement:
    """A layout with how it was found."""

    positions_mm: tuple[float, ...]
    """Ascending, from the left end."""
    log_eigenvalue_product: float
    """Lengths in units of l, W/(EI) = 1; minus infinity where sensors coincide and all eigenvalues count."""
    evaluations: int
    convergence: tuple[float, ...]
    """Best score of the winning start, a value per generation."""


@dataclass(frozen=True)
class _Problem:
    matrix: Array
    """(loads, candidates), dimensionless."""
    rules: Candidates
    leading: int | None

    def score(self, layouts: Indices) -> Array:
        scores = log_eigenvalue_product(np.moveaxis(self.matrix[:, layouts], 1, 0), self.leading)
        return np.where(self.rules.allowed(layouts), scores, -np.inf)


def place(scene: Scene, count: int, seed: int, leading: int | None = None) -> Placement:
    """Place sensors so that the product of the leading eigenvalues (eq. 4) is largest.

    Parameters
    ----------
    scene : its keep-outs, fixed sensors, grid and minimum distance hold
    count : number of sensors
    seed : of the search
    leading : number of eigenvalues that count; `count` by default

    Raises
    ------
    SceneError
        The rules of the scene leave no layout of that many sensors.
    """
    rules = candidates(scene)
    if count < len(rules.fixed):
        message = f"sensors.fixed_mm names {len(rules.fixed)} sensors, more than the {count} to be placed"
        raise SceneError(message)
    problem = _Problem(_dimensionless(scene, rules.position_mm), rules, leading)
    rng = np.random.default_rng(seed)
    starts = [rules.nearest(equal_pitch_mm(scene, count))]
    starts += [rng.integers(len(rules.position_mm), size=count) for _ in range(RESTARTS - 1)]
    runs = [_search(problem, start, rng) for start in starts]
    best, convergence, _ = max(runs, key=lambda run: run[1][-1])
    if not problem.rules.allowed(best[None, :])[0]:
        message = f"found no layout of {count} sensors that keeps sensors.min_distance_mm; make it smaller"
        raise SceneError(message)
    return Placement(
        tuple(float(position) for position in np.sort(rules.position_mm[best])),
        convergence[-1],
        sum(evaluations for _, _, evaluations in runs),
        tuple(convergence),
    )


def score_positions(scene: Scene, positions_mm: Array, leading: int | None = None) -> float:
    """Logarithm of the eigenvalue product of a layout; lengths in units of l, W/(EI) = 1."""
    return float(log_eigenvalue_product(_dimensionless(scene, positions_mm), leading))


def _dimensionless(scene: Scene, positions_mm: Array) -> Array:
    beam = scene.beam
    unit = beam.length_mm / beam.rigidity_n_mm2 * beam.length_mm * beam.length_mm
    return influence(beam, positions_mm, load_positions_mm(scene)) / unit


def _search(problem: _Problem, start: Indices, rng: np.random.Generator) -> tuple[Indices, list[float], int]:
    """One run of the paper's search; returns the best layout, its score per generation, and the evaluations."""
    size = len(problem.rules.position_mm)
    free = slice(len(problem.rules.fixed), None)
    best = np.concatenate([problem.rules.fixed, start[free]])
    scores, evaluations = [float(problem.score(best[None, :])[0])], 1
    step = size / (2 * len(best))
    while len(scores) < MAX_GENERATIONS:
        clones = np.repeat(best[None, :], POPULATION, axis=0)
        change = np.rint(rng.normal(scale=step, size=clones[:, free].shape)).astype(np.intp)
        # Half of the clones move one sensor only: the last grid step is rarely right for all sensors at once.
        one = rng.integers(change.shape[1], size=POPULATION // 2) if change.shape[1] else np.zeros(0, np.intp)
        change[: len(one)] *= np.arange(change.shape[1])[None, :] == one[:, None]
        clones[:, free] = np.clip(clones[:, free] + change, 0, size - 1)
        values = problem.score(clones)
        evaluations += POPULATION
        winner = int(values.argmax())
        if values[winner] > scores[-1]:
            best = clones[winner]
        else:
            if step < 0.5:
                break
            step *= 0.7
        scores.append(max(scores[-1], float(values[winner])))
    return best, scores, evaluations
