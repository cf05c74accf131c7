"""Figures 5 and 6: the paper's search for eight sensors by their four leading eigenvalues, from equal pitch.

This is the plain search of section 4, from one start: clone the best layout, vary the clones, shrink the increment when
nothing gains. It keeps every generation. `placement.search` adds restarts and the rules of a scene.
"""

from dataclasses import dataclass

import numpy as np

from beamtouch_models.arrays import Floats
from beamtouch_models.charts import Chart, Series
from beamtouch_models.reproduction.finding import Figure, Row, compared, rounded
from beamtouch_models.reproduction.paper import LOADS_MM, dimensionless, equal_pitch_mm

SENSORS, LEADING = 8, 4
POPULATION = 100
FIRST_INCREMENT_MM = 20.0
"""Half the pitch of eight sensors; the paper says "a slight variation"."""
SHRINK = 0.5
MIN_INCREMENT_MM = 0.5
"""Half the grid of 1 mm: at smaller increments nothing moves."""
MAX_GENERATIONS = 200
OTHER_SEEDS = 20
EXPECTED_MM = (68, 69, 156, 157, 243, 244, 331, 332)
"""Read from the paper's figure 5."""


@dataclass(frozen=True)
class Search:
    """A run of the paper's search."""

    positions_mm: Floats
    """(generations + 1, sensors): the start, then the best layout of each generation."""
    log_product: Floats
    """(generations + 1,) ln of the product of the leading eigenvalues; lengths in units of l, W/(EI) = 1."""

    @property
    def iterations(self) -> int:
        """Generations after the start."""
        return len(self.log_product) - 1


def paper_search(count: int, leading: int, seed: int) -> Search:
    """Search from equal pitch for the layout with the largest product of the leading eigenvalues, on a 1 mm grid."""
    rng = np.random.default_rng(seed)
    matrix = dimensionless(LOADS_MM)
    best = np.rint(equal_pitch_mm(count)).astype(np.intp)
    score = _scores(matrix, best[None, :], leading)[0]
    increment = FIRST_INCREMENT_MM
    positions, scores = [best], [score]
    while increment >= MIN_INCREMENT_MM and len(scores) <= MAX_GENERATIONS:
        change = np.rint(rng.uniform(-increment, increment, size=(POPULATION, count))).astype(np.intp)
        clones = np.clip(best + change, 1, len(LOADS_MM))
        values = _scores(matrix, clones, leading)
        winner = int(values.argmax())
        if values[winner] > score:
            best, score = clones[winner], values[winner]
        else:
            increment *= SHRINK
        positions.append(best)
        scores.append(score)
    return Search(np.array(positions, dtype=np.float64), np.array(scores))


def figures_5_and_6(seed: int) -> tuple[Figure, Figure]:
    """Return figures 5 and 6: positions and performance value m over the iterations."""
    run = paper_search(SENSORS, LEADING, seed)
    others = [paper_search(SENSORS, LEADING, seed + shift).iterations for shift in range(OTHER_SEEDS)]
    return _figure_5(run, others), _figure_6(run)


def _figure_5(run: Search, iterations: list[int]) -> Figure:
    final = np.sort(run.positions_mm[-1])
    pairs = final.reshape(4, 2)
    merged = float(np.ptp(pairs, axis=1).max())
    asymmetry = float(np.abs(final + final[::-1] - 400).max())
    off = float(np.abs(final - EXPECTED_MM).max())
    rows = (
        compared(
            "fig. 5: positions that eight sensors converge to, mm",
            ", ".join(map(str, EXPECTED_MM)),
            ", ".join(f"{x:g}" for x in final),
            agrees=off <= 1,
            why=f"off by up to {off:g} mm",
        ),
        compared(
            "fig. 5: eight sensors merge into four",
            "four",
            f"{int((np.diff(final) > 10).sum()) + 1}; the sensors of a pair are at most {merged:g} mm apart",
            agrees=merged <= 1,
            why="the pairs did not merge",
        ),
        compared(
            "fig. 5: symmetric about the middle of the beam",
            "yes",
            f"within {asymmetry:g} mm",
            agrees=asymmetry <= 2,
            why="the search stopped short of the optimum",
        ),
        compared(
            "fig. 6: iterations to convergence",
            "about 20",
            f"{run.iterations} ({min(iterations)} to {max(iterations)} over {len(iterations)} seeds)",
            agrees=15 <= run.iterations <= 25,
            why="the paper states neither its population nor its increment",
        ),
    )
    steps = list(range(run.iterations + 1))
    tracks = [Series("", run.positions_mm[:, k].tolist(), steps, k) for k in range(SENSORS)]
    says = "Positions of eight sensors over the iterations of the search: pairs merge, which leaves four places"
    results = {
        "positions_mm": run.positions_mm.tolist(),
        "iterations": run.iterations,
        "iterations_of_other_seeds": iterations,
        "population": POPULATION,
        "first_increment_mm": FIRST_INCREMENT_MM,
    }
    chart = Chart(says, "position of the sensor, mm", "iteration", tracks, x_range=(0.0, 400.0))
    return Figure(5, "positions", f"{says}.", chart, results, rows)


def _figure_6(run: Search) -> Figure:
    # m itself (eq. 4) depends on the unit of deflection; relative to its last value it does not.
    performance = np.exp(run.log_product[-1] - run.log_product)
    half = int(np.argmax(performance < (1 + performance[0]) / 2))
    rows = (
        compared(
            "fig. 6: course of the performance value m",
            "falls, asymptotically",
            f"falls from {performance[0]:.2f} times its last value, half of the way by iteration {half}",
            agrees=bool((np.diff(performance) <= 0).all() and half <= run.iterations / 3),
            why="it does not fall steadily, or falls late",
        ),
        Row(
            "fig. 6: ln of the eigenvalue product, start and end",
            "",
            f"{run.log_product[0]:.4f}, {run.log_product[-1]:.4f} (lengths over l, W/(EI) = 1)",
            "not stated",
        ),
    )
    says = "The performance value m over the iterations of the search, relative to its last value"
    steps = list(range(run.iterations + 1))
    chart = Chart(says, "iteration", "m over its last value", [Series("", steps, rounded(performance))], whole_x=True)
    results = {"m_over_last": rounded(performance), "log_eigenvalue_product": rounded(run.log_product)}
    return Figure(6, "performance", f"{says}.", chart, results, rows)


def _scores(matrix: Floats, layouts: np.ndarray[tuple[int, ...], np.dtype[np.intp]], leading: int) -> Floats:
    """Score all layouts (population, sensors) at once; four of eight components are large enough for a plain SVD."""
    singular = np.linalg.svd(np.moveaxis(matrix[:, layouts - 1], 1, 0), compute_uv=False)[:, :leading]
    scores: Floats = (2 * np.log(singular) - np.log(len(matrix))).sum(axis=1)
    return scores
