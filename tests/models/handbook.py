"""Deflections by the formulas of a handbook."""

import numpy as np

from beamtouch_models.arrays import Floats


def deflection_per_newton(sensor_mm: Floats, load_mm: Floats) -> Floats:
    """A beam of 400 mm on two supports, EI = 210e3 x 25 x 3^3 / 12; Roark, table 8.1, case 1e."""
    length, rigidity = 400.0, 210e3 * 25 * 27 / 12
    left, right = np.minimum(sensor_mm, load_mm), np.maximum(sensor_mm, load_mm)
    found: Floats = left * (length - right) * (length**2 - (length - right) ** 2 - left**2) / (6 * length * rigidity)
    return found
