"""The influence matrix of 399 loads by 399 sensors against PyNiteFEA, for every support kind: agreement and time.

PyNiteFEA computes its members' deflections between nodes exactly, so one member for each section is its most accurate
and its fastest way here: a node at every millimetre took 137 s and agreed to 3e-8. All 399 load positions took it 68 s
for a simple span, as its time for each grows with their number; by default it is run for 21 of them, which favours it,
and times are compared per load position.
"""

import argparse
import time
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from Pynite import FEModel3D

from beamtouch_models.physics.beam import influence
from beamtouch_models.physics.mesh import mesh_of
from beamtouch_models.scene.beam import Beam

Array = NDArray[np.float64]

STEEL = {"length_mm": 400.0, "youngs_modulus_gpa": 210.0, "width_mm": 25.0, "thickness_mm": 3.0}
POSITIONS = np.arange(1.0, 400.0)
SOME_LOADS = 21
REPEATS = 20
BEAMS: dict[str, dict[str, Any]] = {
    "simply-supported": {},
    "cantilever": {"supports": "cantilever"},
    "fixed-fixed": {"supports": "fixed-fixed"},
    "propped": {"supports": "propped"},
    "two spans": {"supports": [{"at_mm": 0}, {"at_mm": 150}, {"at_mm": 400}]},
    "overhangs": {"supports": [{"at_mm": 50}, {"at_mm": 350}]},
    "steps": {"segments": [{"to_mm": 150}, {"to_mm": 250, "thickness_mm": 5}, {"to_mm": 400}]},
}


def run(loads: int = SOME_LOADS) -> list[dict[str, Any]]:
    """Rows of name, value, unit and goal, two for each beam; PyNiteFEA is run for `loads` of the load positions."""
    rows: list[dict[str, Any]] = []
    for name, values in BEAMS.items():
        beam = Beam.model_validate({**STEEL, **values})
        chosen = np.unique(np.linspace(0, len(POSITIONS) - 1, loads).round().astype(np.intp))
        start = time.perf_counter()
        peer = by_pynite(beam, POSITIONS[chosen])
        peer_s = (time.perf_counter() - start) / len(chosen)
        ours_s = min(_seconds(beam) for _ in range(REPEATS)) / len(POSITIONS)
        ours = influence(beam, POSITIONS, POSITIONS)
        apart = float(np.abs(peer - ours[chosen]).max() / np.abs(ours).max())
        rows.append(
            {"name": f"{name}: difference from PyNiteFEA", "value": apart, "unit": "of the largest", "goal": 1e-9}
        )
        rows.append({"name": f"{name}: time of PyNiteFEA over ours", "value": peer_s / ours_s, "unit": "times"})
        rows.append({"name": f"{name}: our time", "value": 1e3 * ours_s * len(POSITIONS), "unit": "ms"})
    return rows


def _seconds(beam: Beam) -> float:
    mesh_of.cache_clear()
    start = time.perf_counter()
    influence(beam, POSITIONS, POSITIONS)
    return time.perf_counter() - start


def by_pynite(beam: Beam, load_mm: Array) -> Array:
    """Influence matrix (loads, 399) by PyNiteFEA: a member for each section, nodes at its ends and at supports."""
    model = FEModel3D()
    model.add_material("material", 210e3, 80e3, 0.3, 7.85e-6)
    ends = [0.0, *(section.to_mm for section in beam.sections)]
    kinds = {support.at_mm: support.kind for support in beam.support_list}
    for at in sorted({*ends, *kinds}):
        model.add_node(f"at {at:g}", at, 0.0, 0.0)
        held = kinds.get(at)
        # In the plane of bending only: along, across and about the beam's axis every node is held where it must be.
        model.def_support(f"at {at:g}", at == 0, held is not None, True, True, True, held == "fixed")
    for (start, end), section in zip(pairwise(ends), beam.sections, strict=True):
        name = f"from {start:g}"
        model.add_section(name, 75.0, 1e4, section.rigidity_n_mm2 / 210e3, 1e4)
        model.add_member(name, f"at {start:g}", f"at {end:g}", "material", name)
    for load in load_mm:
        model.add_load_combo(f"{load:g}", {f"{load:g}": 1.0})
        start = max(end for end in ends[:-1] if end <= load)
        model.add_member_pt_load(f"from {start:g}", "Fy", -1.0, float(load - start), f"{load:g}")
    model.analyze_linear()
    matrix = np.empty((len(load_mm), len(POSITIONS)))
    for start, end in pairwise(ends):
        inside = (start <= POSITIONS) & (end >= POSITIONS)
        for row, load in enumerate(load_mm):
            places = POSITIONS[inside] - start
            found = model.members[f"from {start:g}"].deflection_array("dy", len(places), f"{load:g}", places)
            matrix[row, inside] = -found[1]
    return matrix


def main() -> None:
    """Print the rows."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--loads", type=int, default=SOME_LOADS, help="of the 399 load positions, for PyNiteFEA")
    for row in run(parser.parse_args().loads):
        goal = f"  (goal: under {row['goal']:g})" if "goal" in row else ""
        print(f"{row['name']:<48} {row['value']:>12.4g} {row['unit']}{goal}")


if __name__ == "__main__":
    main()
