"""A model of the shipped plate on springs, with sensors in its corners, made with little effort."""

from pathlib import Path

import numpy as np

from beamtouch_models import read_scene, resolve
from support.surfaces.example_scenes import SCENES

PLATE_SCENE = SCENES / "plate-on-springs.toml"
CORNERS_MM = np.array([[10.0, 10.0], [10.0, 290.0], [390.0, 10.0], [390.0, 290.0]])
LEAST = 0.01
"""Share of the usual effort; figures of the model are rough, its graph is not."""


def write_plate_model(folder: Path) -> None:
    """Write `plate.onnx` into a folder."""
    layout = resolve(read_scene(PLATE_SCENE)).layout(CORNERS_MM)
    layout.build("plate", effort=LEAST).save(folder / "plate.onnx")
