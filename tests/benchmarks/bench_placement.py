"""Our searches for sensor positions beside four packages, on the paper's problem with two to five sensors.

How many of 20 seeds reach the best known layout, and the median time of a run, from the influence matrix on the 1 mm
grid to a layout. What a search prepares is part of its time: ours reduces the matrix to a few coordinates, the packages
get its second moment, from which they score a whole population of layouts by one vectorised determinant.
"""

import argparse
import json
import statistics
import time
import warnings
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from beamtouch_models.arrays import Floats
from beamtouch_models.design.physics.beam import influence_of
from beamtouch_models.design.placement.eigenvalue_bound import largest_gap
from beamtouch_models.design.placement.eigenvalue_product import eigenvalue_product_of
from beamtouch_models.design.placement.placing import place, score_layout
from beamtouch_models.design.placement.search import first_best, search_from
from beamtouch_models.names import SearchName
from support.surfaces.example_scenes import paper_scene
from support.surfaces.stated_problems import problem_in

Search = Callable[["Peer", int, int], Any]

SEEDS = 20
COUNTS = (2, 3, 4, 5)
POPULATION = 100
WORTHLESS = -1e3
"""Score of coincident sensors, for searches that cannot do with minus infinity."""


class Peer:
    """The paper's problem as the packages see it: whole numbers in, scores out."""

    def __init__(self) -> None:
        self.position_mm = np.arange(1.0, 400.0)
        self.matrix = influence_of(paper_scene()).matrix(self.position_mm)

    def scorer(self) -> Callable[[NDArray[Any]], Floats]:
        """A function from layouts (population, sensors) of indices to their log determinants."""
        scaled = self.matrix / self.matrix.max()
        moment = scaled.T @ scaled

        def scores(layouts: NDArray[Any]) -> Floats:
            index = np.clip(np.rint(layouts).astype(int), 0, len(moment) - 1)
            sign, logs = np.linalg.slogdet(moment[index[:, :, None], index[:, None, :]])
            return np.where((sign > 0) & (logs > WORTHLESS), logs, WORTHLESS)

        return scores


def _ours(count: int, search: SearchName, seed: int) -> Floats:
    product = eigenvalue_product_of(*problem_in(paper_scene()), count)
    return product.rules.place_mm[:, 0][first_best(search_from(product.starts(seed), product, search, seed)).layout] - 1


def _pysensors(peer: Peer, count: int, _seed: int) -> Any:  # noqa: ANN401  # the package has no types
    basis = import_module("pysensors.basis").SVD(n_basis_modes=count)
    model = import_module("pysensors.reconstruction").SSPOR(basis=basis, n_sensors=count)
    model.fit(peer.matrix, quiet=True)
    return model.get_selected_sensors()


def _scipy(peer: Peer, count: int, seed: int) -> Any:  # noqa: ANN401  # the package has no types
    scores = peer.scorer()
    return (
        import_module("scipy.optimize")
        .differential_evolution(
            lambda x: -scores(x.T),
            [(0, len(peer.position_mm) - 1)] * count,
            integrality=[True] * count,
            vectorized=True,
            updating="deferred",
            polish=False,
            tol=1e-6,  # the default ends as soon as all layouts are good ones
            rng=seed,
        )
        .x
    )


def _pymoo(peer: Peer, count: int, seed: int) -> Any:  # noqa: ANN401  # the package has no types
    scores = peer.scorer()
    operators, repair = "pymoo.operators", import_module("pymoo.operators.repair.rounding").RoundingRepair
    base: Any = import_module("pymoo.core.problem").Problem

    class Placing(base):  # type: ignore[misc]
        def __init__(self) -> None:
            super().__init__(n_var=count, n_obj=1, xl=0, xu=len(peer.position_mm) - 1, vtype=int)

        def _evaluate(self, x: NDArray[Any], out: dict[str, Floats], *_: object, **__: object) -> None:
            out["F"] = -scores(x)

    algorithm = import_module("pymoo.algorithms.soo.nonconvex.ga").GA(
        pop_size=POPULATION,
        sampling=import_module(f"{operators}.sampling.rnd").IntegerRandomSampling(),
        crossover=import_module(f"{operators}.crossover.sbx").SBX(prob=1.0, eta=3.0, vtype=float, repair=repair()),
        mutation=import_module(f"{operators}.mutation.pm").PM(prob=1.0, eta=3.0, vtype=float, repair=repair()),
        eliminate_duplicates=True,
    )
    return import_module("pymoo.optimize").minimize(Placing(), algorithm, ("n_gen", 100), seed=seed).X


def _pygad(peer: Peer, count: int, seed: int) -> Any:  # noqa: ANN401  # the package has no types
    scores = peer.scorer()
    search = import_module("pygad").GA(
        num_generations=200,
        num_parents_mating=POPULATION // 2,
        sol_per_pop=POPULATION,
        num_genes=count,
        gene_type=int,
        gene_space=range(len(peer.position_mm)),
        fitness_func=lambda _search, layouts, _indices: scores(np.atleast_2d(layouts)).tolist(),
        fitness_batch_size=POPULATION,
        random_seed=seed,
        suppress_warnings=True,
    )
    search.run()
    return search.best_solution()[0]


SEARCHES: dict[str, Search] = {
    "beamtouch exchange": lambda _, count, seed: _ours(count, "exchange", seed),
    "beamtouch paper": lambda _, count, seed: _ours(count, "paper", seed),
    "PySensors SSPOR": _pysensors,
    "scipy differential_evolution": _scipy,
    "pymoo GA": _pymoo,
    "pygad": _pygad,
}


def run(seeds: int = SEEDS, counts: tuple[int, ...] = COUNTS) -> list[dict[str, Any]]:
    """Run every search for every number of sensors; a row each.

    Times are in seconds, `ratio` is over the time of our exchange in the same run. A package that is not installed
    has no row.
    """
    peer, rows = Peer(), []
    with threadpool_limits(1), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # what the packages warn of is not ours
        for count in counts:
            best = place(*problem_in(paper_scene()), count, 0)
            gap = largest_gap(*problem_in(paper_scene()), np.array(best.positions_mm))
            of_count = [
                row
                for name, search in SEARCHES.items()
                if (row := _row(name, search, peer, count, seeds, best.log_eigenvalue_product)) is not None
            ]
            for row in of_count:
                row |= {"ratio": row["median_s"] / of_count[0]["median_s"], "gap": gap}
            rows += of_count
    return rows


def _row(name: str, search: Search, peer: Peer, count: int, seeds: int, optimum: float) -> dict[str, Any] | None:
    times, shortfalls = [], []
    try:
        search(peer, count, seeds)  # imports and first calls are not the search
    except ModuleNotFoundError:
        return None
    for seed in range(seeds):
        started = time.perf_counter()
        found = search(peer, count, seed)
        times.append(time.perf_counter() - started)
        positions = np.sort(peer.position_mm[np.asarray(found, dtype=int)])
        shortfalls.append(optimum - score_layout(influence_of(paper_scene()), positions))
    return {
        "search": name,
        "sensors": count,
        "seeds": seeds,
        "reached": sum(shortfall < 1e-6 for shortfall in shortfalls),
        "worst_shortfall": max(shortfalls),
        "median_s": statistics.median(times),
    }


def main() -> None:
    """Print the table; `--json FILE` writes the rows as well."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the rows as JSON")
    options = parser.parse_args()
    rows = run()
    print(f"{'search':<30}{'sensors':>8}{'optimum':>10}{'short by':>10}{'median s':>10}{'ratio':>8}")
    for row in rows:
        reached = f"{row['reached']}/{row['seeds']}"
        short = f"{max(row['worst_shortfall'], 0):.2g}"
        print(
            f"{row['search']:<30}{row['sensors']:>8}{reached:>10}{short:>10}{row['median_s']:>10.4f}{row['ratio']:>8.1f}"
        )
    if options.json:
        options.json.write_text(json.dumps(rows, indent=2, allow_nan=False) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
