"""Models of measured tables beside models that know the structure: error over its limit, coverage and layout.

`python tests/benchmarks/measured_tables.py` measures a tapered leaf on rubber with 12, 25 and 50 loads, magnets over
Hall sensors with 30 loads, and the paper's beam with 20.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))

import numpy as np

from beamtouch_models import InfluenceFunction, Scene, change_scene, influence_matrix, read_scene, resolve
from support.surfaces import magnetic_strip, tapered_leaf
from support.surfaces.example_scenes import SCENES

EFFORT, DRAWS = 0.25, 10_000
SEEDS = 2
LOADS = 20
"""Of the paper's beam."""
REPEATS = 0.003
"""Part of what a sensor shows by which a load on the paper's beam differs when it is put on anew."""
CANDIDATES_MM = 10.0
"""Distance of the sensors with which it is measured."""


def compare(name: str, scene: Scene, truth: InfluenceFunction) -> None:
    """Print the errors of a model of the table under contacts on the true structure, over its accuracy limit."""
    found = resolve(scene).place().build("measured", effort=EFFORT).evaluate(influence=truth, draws=DRAWS)
    error_mm, limit_mm = found.span.mean_mm, found.span.limit_mean_mm
    print(f"{name}: {error_mm} mm, {found.span.ratio} of {limit_mm}, held {found.position_coverage}", flush=True)


def measure_beam(seed: int) -> None:
    """Print layout and errors of the paper's beam by a table of some loads, beside those by its scene."""
    beam = read_scene(SCENES / "paper.toml")
    places_mm = np.linspace(*beam.contact.position_mm, LOADS)
    candidates_mm = np.arange(CANDIDATES_MM, beam.length_mm, CANDIDATES_MM)
    table = influence_matrix(beam, candidates_mm, places_mm)
    table *= 1 + REPEATS * np.random.default_rng(seed).normal(size=table.shape)
    names = [f"s{place:g}" for place in candidates_mm]
    head = ",".join(["position_mm", *(f"{name}_mm_per_n" for name in names)])
    rows = [",".join(map(str, row)) for row in np.column_stack([places_mm, table]).tolist()]
    measured = change_scene(
        beam,
        beam=None,
        measured={
            "influence": "\n".join([head, *rows]),
            "length_mm": beam.length_mm,
            "sensors_mm": dict(zip(names, candidates_mm.tolist(), strict=True)),
        },
    )
    theory = resolve(beam)
    for name, scene in (("scene", beam), ("table", measured)):
        layout = resolve(scene).place(3, effort=EFFORT)
        limit = theory.layout(layout.positions_mm).limit(draws=DRAWS)
        found = layout.build("strip", effort=EFFORT).evaluate(influence=theory.influence, draws=DRAWS)
        places = ", ".join(f"{place:g}" for place in layout.positions_mm)
        error_mm = found.span.mean_mm
        print(
            f"paper's beam by its {name}: sensors at {places} mm, {error_mm} mm, "
            f"{error_mm.value / limit.value:.3f} of {limit}, held {found.position_coverage}",
            flush=True,
        )


def main() -> None:
    """Print all rows."""
    for loads in (12, 25, 50):
        for seed in range(SEEDS):
            scene = tapered_leaf.scene_of(influence=tapered_leaf.loads_csv(loads, seed))
            compare(f"leaf, {loads} loads", scene, tapered_leaf.true_influence())
    for seed in range(SEEDS):
        scene = magnetic_strip.scene_of(magnetic_strip.loads_csv(30, seed))
        compare("magnetic strip, 30 loads", scene, magnetic_strip.true_influence())
    measure_beam(0)


if __name__ == "__main__":
    main()
