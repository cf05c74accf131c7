"""The influence function of a structure: the form in which physics reaches placement, limits and estimators.

A scene is one way to fill it (`physics.beam.influence_of`). A measured beam or a plate is another.
"""

from collections.abc import Callable
from dataclasses import dataclass

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
