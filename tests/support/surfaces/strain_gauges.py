"""Strain gauges in uV/V on a bar with two overhangs, by statics: a load beyond a support bends it the other way.

No scene can state it: its sensors show bending where they are glued, not how far the bar moves.
"""

import numpy as np

from beamtouch_models import Scene, make_scene
from beamtouch_models.arrays import Floats

LENGTH_MM, SUPPORTS_MM = 500.0, (120.0, 400.0)
WIDTH_MM, THICKNESS_MM, MODULUS_MPA, GAUGE_FACTOR = 30.0, 6.0, 70_000.0, 2.0
GAUGES_MM = {"g1": 90.0, "g2": 170.0, "g3": 260.0, "g4": 350.0, "g5": 430.0}
"""On the lower face, as half bridges with their counterparts on the upper one."""
NOISE_UV_PER_V = 0.25


def influence(gauge_mm: Floats, load_mm: Floats) -> Floats:
    """Return the output (loads, gauges) in uV/V per newton: half the gauge factor times the strain, in 1e-6."""
    left, right = SUPPORTS_MM
    load, gauge = np.asarray(load_mm, float)[:, None], np.asarray(gauge_mm, float)
    lever_right = (load - left) / (right - left)
    moment = np.maximum(gauge - left, 0) * (1 - lever_right) + np.maximum(gauge - right, 0) * lever_right
    moment = moment - np.maximum(gauge - load, 0)
    modulus_mm3 = WIDTH_MM * THICKNESS_MM**2 / 6
    output: Floats = 1e6 * GAUGE_FACTOR / 2 * moment / modulus_mm3 / MODULUS_MPA
    return output


def loads_csv(loads: int, seed: int = 0, repeats: float = 0.003) -> str:
    """Return a table of loads that a person put on, which repeat to a share of what gauges show."""
    rng = np.random.default_rng(seed)
    place_mm = np.linspace(10, LENGTH_MM - 10, loads)
    force_n = rng.choice([5.0, 10.0, 20.0], loads)
    shown = influence(np.array(list(GAUGES_MM.values())), place_mm) * force_n[:, None]
    shown = shown * (1 + repeats * rng.normal(size=shown.shape)) + 0.05 * rng.normal(size=shown.shape)
    head = ["position_mm", "force_n", *(f"{name}_deflection_uV/V" for name in GAUGES_MM)]
    rows = np.column_stack([place_mm, force_n, shown])
    return "\n".join([",".join(head), *(",".join(f"{value:.6g}" for value in row) for row in rows)]) + "\n"


def scene_of(table: str) -> Scene:
    """Return its scene, with a table of measured influence."""
    return make_scene(
        measured={"influence": table, "length_mm": LENGTH_MM, "sensors_mm": GAUGES_MM},
        contact={"force_n": [2, 20], "position_mm": [10, LENGTH_MM - 10]},
        sensors={"noise_mm": NOISE_UV_PER_V, "rate_hz": 100, "range_mm": [-500, 500]},
        requirements={"latency_ms": 50, "descriptors": ["position", "force"]},
    )
