"""The influence function of a structure: the form in which physics reaches placement, limits and estimators.

A scene is one way to fill it (`physics.beam.influence_of`). A measured beam or a plate is another.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from beamtouch_models.arrays import Floats


@dataclass(frozen=True)
class InfluenceFunction:
    """Deflections of a structure per newton, for its range of contacts."""

    length_mm: float
    """Sensors and contacts stand at 0 to `length_mm`."""
    load_mm: Floats
    """(loads,) evenly spaced and ascending; contacts lie between the first and the last."""
    force_n: tuple[float, float]
    """Range of forces; equal ends if the force is known."""
    at: Callable[[Floats, Floats], Floats]
    """From positions of sensors (sensors,) and loads (loads,), both in mm, to the influence matrix (loads, sensors) in
    mm/N."""
    unit_mm_per_n: float = 1.0
    """Deflection per newton that counts as 1 in a dimensionless score; l^3/(EI) of a beam."""

    @property
    def position_mm(self) -> tuple[float, float]:
        """Range of contact positions."""
        return float(self.load_mm[0]), float(self.load_mm[-1])

    def matrix(self, sensor_mm: Floats) -> Floats:
        """Return the influence matrix of sensors (sensors,) under all loads, (loads, sensors) in mm/N."""
        return self.at(sensor_mm, self.load_mm)

    def deviation(self, sensor_mm: Floats, load_mm: Floats, tolerance_mm: float) -> Floats:
        """Return what a tolerance of the sensors' positions makes of the influence, (loads, sensors) in mm/N.

        These are standard deviations, with the sign of the change towards the right. Errors as `at`.
        """
        left, right = (np.clip(sensor_mm + side * tolerance_mm, 0.0, self.length_mm) for side in (-1, 1))
        change = self.at(right, load_mm) - self.at(left, load_mm)
        # At an end of the beam the sensor can move to one side only.
        deviation: Floats = change * (tolerance_mm / np.maximum(right - left, np.finfo(np.float64).tiny))
        return deviation
