"""The influence function of a structure: the form in which physics reaches placement, limits and estimators.

A scene is one way to fill it (`physics.beam.influence_of`). A measured beam, or any structure along
a line, is another; a model file holds neither.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from beamtouch_models.arrays import Floats
from beamtouch_models.errors import SceneError, require
from beamtouch_models.numbers import array_of

EVEN = 1e-6
"""Largest difference between the steps of even load positions, relative to a step."""


@dataclass(frozen=True, eq=False)
class InfluenceFunction:
    """Deflections of a structure per newton, for its range of contacts.

    >>> def at(sensor_mm, load_mm):  # a string of 400 mm that is pulled with 100 N
    ...     left, right = np.minimum.outer(load_mm, sensor_mm), 400 - np.maximum.outer(load_mm, sensor_mm)
    ...     return left * right / (400 * 100)
    >>> string = InfluenceFunction(400, np.linspace(10, 390, 381), (2, 20), at)
    >>> string.matrix(np.array([200])).max()
    np.float64(1.0)

    Raises
    ------
    ValueError
        A field breaks the rule documented on it; the message names it.
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
        object.__setattr__(self, "at", partial(_checked, self.at))
        # A few values, in no order, so that a function with swapped arguments is refused at once.
        self.at(self.length_mm * np.array([0.7, 0.2, 0.5]), load[[-1, 0]])

    def _require(self, name: str, is_kept: bool, wanted: str) -> None:
        if not is_kept:
            raise ValueError(f"{name} of an influence function must be {wanted}, not {getattr(self, name)}")

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


def _checked(at: Callable[[Floats, Floats], Floats], sensor_mm: Floats, load_mm: Floats) -> Floats:
    """Return what the user's function returns; ValueError unless these are finite numbers of the right shape."""
    matrix, wanted = array_of(at(sensor_mm, load_mm), "at of an influence function"), (len(load_mm), len(sensor_mm))
    must = "at of an influence function must return finite values of shape (loads, sensors)"
    if matrix.shape != wanted:
        raise ValueError(f"{must}, here {wanted}, not {matrix.shape}")
    if not np.isfinite(matrix).all():
        load, sensor = np.argwhere(~np.isfinite(matrix))[0]
        where = f"for a sensor at {sensor_mm[sensor]:g} and a load at {load_mm[load]:g} mm"
        raise ValueError(f"{must}, not {matrix[load, sensor]} {where}")
    return matrix


def check_own(
    influence: InfluenceFunction, length_mm: float, position_mm: tuple[float, float], force_n: tuple[float, float]
) -> None:
    """Raise SceneError unless what a user gives is an influence function for a scene's length and contacts."""
    require(influence, InfluenceFunction, "influence", "an InfluenceFunction")
    for name, own, scene in (
        ("length_mm", (influence.length_mm,), (length_mm,)),
        ("load_mm", influence.position_mm, position_mm),
        ("force_n", influence.force_n, force_n),
    ):
        if not np.allclose(own, scene, rtol=EVEN, atol=0.0 if name == "force_n" else EVEN * length_mm):
            ours, theirs = (" to ".join(f"{value:.12g}" for value in values) for values in (own, scene))
            raise SceneError(f"influence: its {name} is {ours}, but that of the scene is {theirs}; make them equal")
