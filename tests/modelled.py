"""What the sensors of a model would measure, by the Python interface."""

from functools import cache

import numpy as np
from numpy.typing import ArrayLike

from beamtouch_models import Scene, influence_matrix, read_scene
from beamtouch_models.arrays import Floats
from beamtouch_models.modelfile import ModelFile

_read_scene = cache(read_scene)


def scene_of(model: ModelFile) -> Scene:
    """Return the scene that a model was built from."""
    return _read_scene(f"{model.metadata.scene}\n")


def deflections_of(model: ModelFile, position_mm: ArrayLike, force_n: ArrayLike) -> Floats:
    """Return the deflections (loads, channels) in mm of loads at positions [mm] with forces [N], both (loads,)."""
    at_mm = [channel.position_mm for channel in model.metadata.layout]
    deflection_mm: Floats = np.asarray(force_n)[:, None] * influence_matrix(scene_of(model), at_mm, position_mm)
    return deflection_mm
