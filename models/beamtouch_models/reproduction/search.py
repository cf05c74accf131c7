"""Figures 5 and 6: the paper's search for eight sensors by their four leading eigenvalues, from equal pitch.

This is the search of section 4 as `placement.search` has it, from one start.
"""

import numpy as np

from beamtouch_models.arrays import Floats
from beamtouch_models.charts import Chart, Series
from beamtouch_models.placement.eigenvalue_product import eigenvalue_product_of
from beamtouch_models.placement.search import SearchRun, paper_search
from beamtouch_models.reproduction.finding import Figure, Row, compared, rounded
from beamtouch_models.reproduction.paper import SCENE
from beamtouch_models.surface import Surface

SENSORS, LEADING = 8, 4
OTHER_SEEDS = 20
EXPECTED_MM = (68, 69, 156, 157, 243, 244, 331, 332)
"""Read off the paper's figure 5."""
EXPECTED_ITERATIONS = 20
"""The paper: "within approximately 20 iterations"."""


def figures_5_and_6(seed: int) -> tuple[Figure, Figure]:
    """Return figures 5 and 6: positions and performance value m over the iterations."""
    surface = Surface.of(SCENE)
    product = eigenvalue_product_of(surface.influence, surface.rules, SENSORS, LEADING)
    start = SearchRun((product.equal,), (float(product.scores(product.equal[None])[0]),), 1)
    run, *others = (
        paper_search(product, start, np.random.default_rng(seed + shift)) for shift in range(OTHER_SEEDS + 1)
    )
    iterations = [iterations_of(one) for one in (run, *others)]
    return _figure_5(run, surface.rules.position_mm[np.array(run.layouts)], iterations), _figure_6(run)


def iterations_of(run: SearchRun) -> int:
    """Return the number of iterations up to the last gain."""
    return int(np.flatnonzero(np.diff(run.scores))[-1]) + 1


def _figure_5(run: SearchRun, positions_mm: Floats, iterations: list[int]) -> Figure:
    final, own = positions_mm[-1], iterations[0]
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
            f"about {EXPECTED_ITERATIONS}",
            f"{own} ({min(iterations)} to {max(iterations)} over {len(iterations)} seeds)",
            agrees=15 <= own <= 25,
            why="the paper states neither its population nor its increment",
        ),
    )
    steps = list(range(len(run.scores)))
    tracks = [Series("", positions_mm[:, k].tolist(), steps, k) for k in range(SENSORS)]
    tracks += [Series("read off the paper's figure 5", EXPECTED_MM, [steps[-1]] * SENSORS, 0, "ring")]
    says = "Positions of eight sensors over the iterations of the search: pairs merge, which leaves four places"
    results = {
        "positions_mm": positions_mm.tolist(),
        "iterations": own,
        "iterations_of_other_seeds": iterations[1:],
    }
    chart = Chart(says, "position of the sensor, mm", "iteration", tracks, x_range=(0.0, 400.0))
    return Figure(5, "positions", f"{says}.", chart, results, rows)


def _figure_6(run: SearchRun) -> Figure:
    # m itself (eq. 4) depends on the unit of deflection; relative to its last value it does not.
    performance, iterations = np.exp(run.scores[-1] - np.array(run.scores)), len(run.scores) - 1
    half = int(np.argmax(performance < (1 + performance[0]) / 2))
    rows = (
        compared(
            "fig. 6: course of the performance value m",
            "falls, asymptotically",
            f"falls from {performance[0]:.2f} times its last value, half of the way by iteration {half}",
            agrees=bool((np.diff(performance) <= 0).all() and half <= iterations / 3),
            why="it does not fall steadily, or falls late",
        ),
        Row(
            "fig. 6: ln of the eigenvalue product, start and end",
            "",
            f"{run.scores[0]:.4f}, {run.scores[-1]:.4f} (lengths over l, W/(EI) = 1)",
            "not stated",
        ),
    )
    says = "The performance value m over the iterations of the search, relative to its last value"
    steps = list(range(iterations + 1))
    stated = [EXPECTED_ITERATIONS] * 2
    series = [
        Series("m", steps, rounded(performance)),
        Series("the paper: converged after about 20 iterations", stated, [1.0, float(performance[0])], 1, "dashed"),
    ]
    chart = Chart(says, "iteration", "m over its last value", series, whole_x=True)
    results = {"m_over_last": rounded(performance), "log_eigenvalue_product": rounded(list(run.scores))}
    return Figure(6, "performance", f"{says}.", chart, results, rows)
