"""A rigid plate on four equal springs at its corners: it sinks and tilts in two directions, by statics."""

import numpy as np

from beamtouch_models.arrays import Floats

SIZE_MM = np.array([400.0, 300.0])
SPRING_N_PER_MM = 15.0


def sunk_mm(sensor_mm: Floats, load_mm: Floats) -> Floats:
    """Return the deflection at each sensor per newton, (loads, sensors)."""
    sensor, load = (2 * place / SIZE_MM - 1 for place in (sensor_mm, load_mm))
    sunk: Floats = (1 + load @ sensor.T) / (4 * SPRING_N_PER_MM)
    return sunk
