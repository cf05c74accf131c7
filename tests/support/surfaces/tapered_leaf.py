"""A tapered leaf spring that lies on rubber, with physics of its own: no scene can state it."""

from pathlib import Path

import numpy as np
from numpy.polynomial import legendre

from beamtouch_models import InfluenceFunction, Scene, change_scene, format_scene, make_scene
from beamtouch_models.arrays import Floats

LENGTH_MM = 300.0
SENSORS_MM = {"left": 45.0, "inner": 120.0, "outer": 195.0, "right": 270.0}
TERMS, POINTS = 24, 400
"""Of the series for its shape, and of the integrals over its length."""
SOFT_N_MM2, STIFF_N_MM2 = 0.4e6, 4e6
"""Rigidity of its ends."""
RUBBER_N_MM2 = 0.12, 0.3
"""Stiffness of the rubber at the left and at the right end, per length."""


def influence(sensor_mm: Floats, load_mm: Floats) -> Floats:
    """Return the deflection (loads, sensors) in mm/N, by Ritz's method with Legendre polynomials."""
    nodes, weights = legendre.leggauss(POINTS)
    share, weights = (nodes + 1) / 2, weights * LENGTH_MM / 2
    rigidity = SOFT_N_MM2 + (STIFF_N_MM2 - SOFT_N_MM2) * share**2
    rubber = RUBBER_N_MM2[0] + (RUBBER_N_MM2[1] - RUBBER_N_MM2[0]) * share
    shapes = [np.eye(TERMS)[term] for term in range(TERMS)]
    shape = np.array([legendre.legval(nodes, one) for one in shapes])
    bent = np.array([legendre.legval(nodes, legendre.legder(one, 2)) for one in shapes]) * (2 / LENGTH_MM) ** 2
    stiffness = (bent * weights * rigidity) @ bent.T + (shape * weights * rubber) @ shape.T

    def at(position_mm: Floats) -> Floats:
        return np.array([legendre.legval(2 * np.asarray(position_mm) / LENGTH_MM - 1, one) for one in shapes])

    matrix: Floats = at(load_mm).T @ np.linalg.solve(stiffness, at(sensor_mm))
    return matrix


def scene_of(**measured: object) -> Scene:
    """Return its scene, with a table of measured influence."""
    places = {"length_mm": LENGTH_MM, "sensors_mm": SENSORS_MM}
    return change_scene(STATED, measured=places | measured)


STATED = make_scene(
    contact={"force_n": [2, 20], "position_mm": [15, 285]},
    sensors={"noise_mm": 0.004, "rate_hz": 100, "range_mm": [1, 9]},
    requirements={"latency_ms": 50, "descriptors": ["position", "force"]},
)
"""All that is known of it but the structure."""


def true_influence() -> InfluenceFunction:
    """Return what nobody who measures it knows."""
    low, high = STATED.contact.position_mm
    return InfluenceFunction(LENGTH_MM, np.linspace(low, high, 361), STATED.contact.force_range_n, influence)


def loads_csv(loads: int, seed: int = 0, repeats: float = 0.003) -> str:
    """Return a table of loads that a person put on by a ruler, which repeat to a share of what sensors show."""
    rng, names = np.random.default_rng(seed), list(SENSORS_MM)
    place_mm = np.linspace(15, 285, loads)
    force_n = rng.choice([5.0, 10.0, 20.0], loads)
    shown = influence(np.array(list(SENSORS_MM.values())), place_mm) * force_n[:, None]
    shown = shown * (1 + repeats * rng.normal(size=shown.shape)) + 0.001 * rng.normal(size=shown.shape)
    rows = np.column_stack([place_mm, force_n, shown])
    head = ["position_mm", "force_n", *(f"{name}_deflection_mm" for name in names)]
    return "\n".join([",".join(head), *(",".join(f"{value:.6g}" for value in row) for row in rows)]) + "\n"


def write_scene(folder: Path, table: str) -> Path:
    """Write the table and the scene that names it into a folder; returns the path of the scene."""
    (folder / "leaf.csv").write_text(table)
    text = format_scene(scene_of(influence=table))
    start, end = text.index('"""'), text.rindex('"""') + 3
    path = folder / "leaf.toml"
    path.write_text(text[:start] + '"leaf.csv"' + text[end:])
    return path
