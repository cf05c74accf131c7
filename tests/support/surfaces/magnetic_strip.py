"""Magnets in a soft strip over Hall sensors in uT, by the field of dipoles: what a sensor shows may be negative.

No scene can state it. The strip lies on a bed of springs: a load presses it down about its place, and the magnets near
it, whose field upwards changes at the sensors below. Where a magnet comes nearer, beside its axis, the field may fall.
"""

import numpy as np

from beamtouch_models import InfluenceFunction, Scene, make_scene
from beamtouch_models.arrays import Floats

LENGTH_MM = 200.0
SENSORS_MM = {f"h{number}": place for number, place in enumerate((20.0, 52.0, 84.0, 116.0, 148.0, 180.0), start=1)}
MAGNETS_MM = np.arange(10.0, 200.0, 20.0)
MOMENT_AM2 = 0.02
HEIGHT_MM = 12.0
"""Of the magnets above the sensors, at rest."""
SOFT_MM_PER_N, SPREAD_MM = 0.05, 22.0
"""How far the strip yields under a load, and how far to each side (its characteristic length)."""
UT_MM3 = 1e-7 * 1e9 * 1e6
"""Permeability of the vacuum over 4 pi, in uT mm^3 / (A m^2)."""
NOISE_UT = 1.0


def influence(sensor_mm: Floats, load_mm: Floats) -> Floats:
    """Return the field (loads, sensors) in uT per newton: that of dipoles that point upwards, for a small movement."""
    beside_mm = np.asarray(sensor_mm, float)[:, None] - MAGNETS_MM
    square = beside_mm**2 + HEIGHT_MM**2
    # The field of a dipole along its axis, (3 z^2 - R^2) / R^5 at a distance R, and its change as z becomes smaller.
    nearer = UT_MM3 * MOMENT_AM2 * HEIGHT_MM * (6 * HEIGHT_MM**2 - 9 * beside_mm**2) / square**3.5
    away = np.abs(np.asarray(load_mm, float)[:, None] - MAGNETS_MM) / SPREAD_MM
    moved_mm = SOFT_MM_PER_N * np.exp(-away) * (np.cos(away) + np.sin(away))
    field: Floats = moved_mm @ nearer.T
    return field


def loads_csv(loads: int, seed: int = 0, repeats: float = 0.003) -> str:
    """Return a table of loads that a person put on, which repeat to a share of what sensors show."""
    rng = np.random.default_rng(seed)
    place_mm = np.linspace(10, LENGTH_MM - 10, loads)
    force_n = rng.choice([2.0, 5.0, 10.0], loads)
    shown = influence(np.array(list(SENSORS_MM.values())), place_mm) * force_n[:, None]
    shown = shown * (1 + repeats * rng.normal(size=shown.shape)) + 0.2 * NOISE_UT * rng.normal(size=shown.shape)
    head = ["position_mm", "force_n", *(f"{name}_deflection_uT" for name in SENSORS_MM)]
    rows = np.column_stack([place_mm, force_n, shown])
    return "\n".join([",".join(head), *(",".join(f"{value:.6g}" for value in row) for row in rows)]) + "\n"


def scene_of(table: str) -> Scene:
    """Return its scene, with a table of measured influence."""
    return make_scene(
        measured={"influence": table, "length_mm": LENGTH_MM, "sensors_mm": SENSORS_MM},
        contact={"force_n": [1, 10], "position_mm": [10, LENGTH_MM - 10]},
        sensors={"noise_mm": NOISE_UT, "rate_hz": 100, "range_mm": [-2000, 2000]},
        requirements={"latency_ms": 50, "descriptors": ["position", "force"]},
    )


def true_influence() -> InfluenceFunction:
    """Return what nobody who measures it knows."""
    return InfluenceFunction(LENGTH_MM, np.linspace(10, LENGTH_MM - 10, 361), (1, 10), influence)
