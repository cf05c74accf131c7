"""The influence function of a structure: the form in which physics reaches placement, limits and estimators.

A scene is one way to fill it (`physics.beam.influence_of`). A measured beam or a plate is another.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from beamtouch_models.arrays import Floats

EVEN = 1e-6
"""Largest difference between the steps of even load positions, relative to a step."""


@dataclass(frozen=True, eq=False)
class InfluenceFunction:
    """Deflections of a structure per newton, for its range of contacts.

    Raises
    ------
    ValueError
        A field is not as its line says; the message names it.
    """

    length_mm: float
    """Sensors and contacts stand at 0 to `length_mm`."""
    load_mm: Floats
    """(loads,) evenly spaced and ascending; contacts lie between the first and the last."""
    force_n: tuple[float, float]
    """Range of forces, positive; equal ends if the force is known."""
    at: Callable[[Floats, Floats], Floats]
    """From positions of sensors (sensors,) and loads (loads,), both in mm, to the influence matrix (loads, sensors) in
    mm/N. Both come in any order, and anywhere on 0 to `length_mm`: equal pitch, for example, puts sensors where rules
    allow none. All values are finite. So a table of measurements is interpolated over the whole length."""
    unit_mm_per_n: float = 1.0
    """Deflection per newton that counts as 1 in a dimensionless score, positive; l^3/(EI) of a beam."""

    def __post_init__(self) -> None:
        load = np.array(self.load_mm, dtype=np.float64)  # a copy: the caller may change its array
        object.__setattr__(self, "load_mm", load)
        self._require("length_mm", 0 < self.length_mm < math.inf, "a positive number")
        self._require("load_mm", load.ndim == 1 and load.size > 1, "a list of two positions or more")
        self._require("load_mm", bool(np.isfinite(load).all()), "finite")
        self._require("load_mm", bool(load.min() >= 0 and load.max() <= self.length_mm), "at 0 to length_mm")
        steps = np.diff(load)
        uneven = EVEN * float(steps.mean()) + 16 * float(np.spacing(self.length_mm))
        self._require("load_mm", bool(steps.min() > 0 and np.ptp(steps) <= uneven), "ascending and evenly spaced")
        low, high = self.force_n
        self._require("force_n", 0 < low <= high < math.inf, "positive, the first no larger than the second")
        self._require("unit_mm_per_n", 0 < self.unit_mm_per_n < math.inf, "a positive number")
        self._check_at()

    def _require(self, name: str, is_kept: bool, wanted: str) -> None:
        if not is_kept:
            raise ValueError(f"{name} of an influence function must be {wanted}, not {getattr(self, name)}")

    def _check_at(self) -> None:
        """Ask for a few values, in no order, so that a function with swapped arguments is refused at once."""
        sensor, load = self.length_mm * np.array([0.7, 0.2, 0.5]), self.load_mm[[-1, 0]]
        matrix = np.asarray(self.at(sensor, load))
        if matrix.shape != (2, 3) or not np.isfinite(matrix).all():
            raise ValueError(
                "at of an influence function must return finite values of shape (loads, sensors), here (2, 3), not "
                f"{matrix.tolist()}"
            )

    @property
    def position_mm(self) -> tuple[float, float]:
        """Range of contact positions."""
        return float(self.load_mm[0]), float(self.load_mm[-1])

    def matrix(self, sensor_mm: Floats) -> Floats:
        """Return the influence matrix of sensors (sensors,) under all loads, (loads, sensors) in mm/N."""
        return self.at(sensor_mm, self.load_mm)

    def deviation(self, sensor_mm: Floats, load_mm: Floats, tolerance_mm: float) -> Floats:
        """Return the change of the influence by a tolerance of the sensors' positions, (loads, sensors) in mm/N.

        These are standard deviations, with the sign of the change towards the right. Errors as `at`.
        """
        left, right = (np.clip(sensor_mm + side * tolerance_mm, 0.0, self.length_mm) for side in (-1, 1))
        change = self.at(right, load_mm) - self.at(left, load_mm)
        # At an end of the beam the sensor can move to one side only.
        deviation: Floats = change * (tolerance_mm / np.maximum(right - left, np.finfo(np.float64).tiny))
        return deviation
