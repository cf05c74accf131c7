"""A string under loads: a structure whose influence is a closed form."""

import numpy as np

from beamtouch_models.arrays import Floats
from beamtouch_models.design.physics.influence_function import InfluenceFunction
from beamtouch_models.places import on_axis


def string_mm(sensor_mm: Floats, load_mm: Floats) -> Floats:
    """A string of 400 mm that is pulled with 100 N."""
    left, right = np.minimum(load_mm, sensor_mm.T), 400 - np.maximum(load_mm, sensor_mm.T)
    lowered: Floats = left * right / (400 * 100)
    return lowered


STRING = InfluenceFunction((400.0,), on_axis(np.linspace(10, 390, 381)), (2.0, 20.0), string_mm)
