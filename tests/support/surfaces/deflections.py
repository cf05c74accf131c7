"""What the sensors of a model would measure, by the Python interface."""

from functools import cache

import numpy as np
from numpy.typing import ArrayLike

from beamtouch_models import influence_matrix, read_scene
from beamtouch_models.arrays import Floats
from beamtouch_models.runtime import ModelFile

_read_scene = cache(read_scene)


def deflections_of(model: ModelFile, position_mm: ArrayLike, force_n: ArrayLike) -> Floats:
    """Return the deflections (loads, channels) in mm of loads at positions [mm] with forces [N], both (loads,)."""
    at_mm = [channel.position_mm for channel in model.metadata.layout]
    scene = _read_scene(model.metadata.scene)
    deflection_mm: Floats = np.asarray(force_n)[:, None] * influence_matrix(scene, at_mm, position_mm)
    return deflection_mm
