"""The influence matrix of each shipped scene beside transfer matrices in 60 digits, at places drawn along the beam."""

import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parent.parent))  # for what tests and benchmarks share

import numpy as np

from beamtouch_models.design.physics.beam import influence_matrix
from beamtouch_models.design.scene import load_scene
from models.exact_beam import ExactBeam
from support.surfaces.example_scenes import SCENES


def run() -> list[dict[str, Any]]:
    """A row of the largest difference for each scene, at 8 loads and 4 sensors."""
    return [_row(path) for path in sorted(SCENES.glob("*.toml"))]


def _row(path: Path) -> dict[str, Any]:
    scene, _ = load_scene(path)
    rng = np.random.default_rng(3)
    load_mm, sensor_mm = (np.sort(rng.uniform(0.02, 0.98, count)) * scene.beam.length_mm for count in (8, 4))
    exact = ExactBeam(scene.beam, 60)
    wanted = np.array([[exact.deflection(x, a, scene.contact.width_mm) for x in sensor_mm] for a in load_mm])
    apart = np.abs(influence_matrix(scene, sensor_mm, load_mm) - wanted).max() / np.abs(wanted).max()
    return {"name": f"{path.stem}: difference from 60 digits", "value": float(apart), "unit": "of the largest"}
