"""A soft skin over four magnetometers in uT, each below a magnet, with physics of its own: no scene can state it.

A force presses the magnets down as it presses an elastic half-space at their depth (Boussinesq), and the field of a
dipole changes with its distance. The first two sensors measure the field across the skin, the others that along x,
which is negative on one side.
"""

from pathlib import Path

import numpy as np

from beamtouch_models import Scene, make_scene
from beamtouch_models.arrays import Floats

SIZE_MM = 60.0, 40.0
SENSORS_MM = {"nw": (15.0, 30.0), "se": (45.0, 10.0), "sw": (15.0, 10.0), "ne": (45.0, 30.0)}
DEPTH_MM, GAP_MM = 9.0, 6.0
"""Of the magnets below the surface, and of the magnetometers below them."""
SINKS_MM2_PER_N = 0.4
"""How far a magnet sinks, times the distance from the load."""
FIELD_UT_MM3 = 1.2e5
"""Of a dipole, at a distance of 1 mm."""
NOISE_UT = 0.5


def influence(place_mm: Floats) -> Floats:
    """Return the change of the field (places, sensors) in uT per newton at places (places, 2)."""
    columns = []
    for number, at_mm in enumerate(SENSORS_MM.values()):
        x, y = (place_mm - np.array(at_mm)).T
        distance = np.sqrt(x**2 + y**2 + DEPTH_MM**2)
        sinks = SINKS_MM2_PER_N / distance
        slides = SINKS_MM2_PER_N * x / distance**2
        steep = 3 * FIELD_UT_MM3 / GAP_MM**4
        columns.append(steep * (2 * sinks if number < len(SENSORS_MM) / 2 else 2 * slides))
    return np.stack(columns, axis=1)


def grid(along: int, across: int) -> Floats:
    """Return the places of an even grid over the skin."""
    ticks = np.linspace(3, SIZE_MM[0] - 3, along), np.linspace(3, SIZE_MM[1] - 3, across)
    return np.stack(np.meshgrid(*ticks, indexing="ij"), axis=-1).reshape(-1, 2)


def loads_csv(place_mm: Floats, seed: int = 0, repeats: float = 0.003) -> str:
    """Return a table of loads at places (places, 2), which repeat to a share of what sensors show."""
    rng = np.random.default_rng(seed)
    force_n = rng.choice([2.0, 4.0, 8.0], len(place_mm))
    shown = influence(place_mm) * force_n[:, None]
    shown = shown * (1 + repeats * rng.normal(size=shown.shape)) + 0.1 * rng.normal(size=shown.shape)
    head = ["x_mm", "y_mm", "force_n", *(f"{name}_deflection_uT" for name in SENSORS_MM)]
    rows = np.column_stack([place_mm, force_n, shown])
    return "\n".join([",".join(head), *(",".join(f"{value:.6g}" for value in row) for row in rows)]) + "\n"


def scene_of(table: str) -> Scene:
    """Return its scene, with a table of measured influence."""
    places = {name: {"x_mm": x, "y_mm": y} for name, (x, y) in SENSORS_MM.items()}
    return make_scene(
        measured={"influence": table, "length_x_mm": SIZE_MM[0], "length_y_mm": SIZE_MM[1], "sensors_mm": places},
        contact={"force_n": [1, 8], "x_mm": [3, SIZE_MM[0] - 3], "y_mm": [3, SIZE_MM[1] - 3]},
        sensors={"noise_mm": NOISE_UT, "rate_hz": 100, "range_mm": [-2000, 2000]},
        requirements={"latency_ms": 50, "descriptors": ["position", "force"]},
    )


def write_scene(folder: Path, table: str) -> Path:
    """Write the table and the scene that names it into a folder; returns the path of the scene."""
    (folder / "skin.csv").write_text(table)
    path = folder / "skin.toml"
    places = ", ".join(f"{name} = {{ x_mm = {x}, y_mm = {y} }}" for name, (x, y) in SENSORS_MM.items())
    path.write_text(
        f"""
[measured]
influence = "skin.csv"
length_x_mm = {SIZE_MM[0]}
length_y_mm = {SIZE_MM[1]}
sensors_mm = {{ {places} }}

[contact]
force_n = [1, 8]
x_mm = [3, {SIZE_MM[0] - 3}]
y_mm = [3, {SIZE_MM[1] - 3}]

[sensors]
noise_mm = {NOISE_UT}
rate_hz = 100
range_mm = [-2000, 2000]
"""
    )
    return path
