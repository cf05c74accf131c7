"""The influence function of a structure: the form in which physics reaches placement, limits and estimators.

A scene's beam is one way to fill it (`physics.beam.influence_of`). A measured table, or any elastic structure of one
axis or two, is another; a model file holds none. What follows reads places only (`places`): what each sensor shows per
newton there, how that changes along each axis, and how uncertain it is.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from beamtouch_common.digits import Rounded
from beamtouch_models.arrays import Floats
from beamtouch_models.errors import SceneError, require
from beamtouch_models.numbers import array_of
from beamtouch_models.places import Extent, grid_of, in_rows

EVEN = 1e-6
"""Largest difference between the steps of even load positions, relative to a step."""
LOADS = 400
"""Steps of load positions over the length of a structure, as in the paper."""
PLATE_LOADS = 1200
"""Loads on a whole structure of two axes, about."""
POINTS, PLATE_POINTS = 801, 33**2
"""Points of a beam, and of a plate, at which its travel is computed."""


@dataclass(frozen=True)
class Interpolation:
    """Uncertainty of a table of measured influence between its places."""

    deviation_at: Callable[[Floats, Floats], Floats]
    """From places of sensors (sensors, axes) and loads (loads, axes) to the standard deviation of the influence there,
    (loads, sensors) in mm/N."""
    spacing_mm: float
    """Largest distance of neighbouring places of the table."""
    order: float = math.nan
    """The power of that distance with which the deviation falls; NaN if that is not known."""
    repeats: Callable[[Floats, Floats], Floats] | None = None
    """Like `deviation_at`: how far the influence differs when a load is put on anew; None: it repeats."""
    shared_at: Callable[[Floats], Floats] | None = None
    """From places of sensors (sensors, axes) to the loadings (sensors, sources) of what both leave open: the share of
    its standard deviation by which a sensor follows each of a few independent sources that all have in common. None:
    sensors err independently."""


@dataclass(frozen=True, eq=False, repr=False)
class InfluenceFunction:
    """Deflections of a structure per newton, for its range of contacts.

    Of a beam, whose `length_mm` is a number, positions (n,) may stand for places (n, 1), and `at` takes positions.

    >>> def at(sensor_mm, load_mm):  # a string of 400 mm that is pulled with 100 N
    ...     left, right = np.minimum.outer(load_mm, sensor_mm), 400 - np.maximum.outer(load_mm, sensor_mm)
    ...     return left * right / (400 * 100)
    >>> string = InfluenceFunction(400, np.linspace(10, 390, 381), (2, 20), at)
    >>> string
    InfluenceFunction(400 mm, loads at 10..390 mm with 2..20 N)
    >>> string.matrix(np.array([200])).max()
    np.float64(1.0)

    Raises
    ------
    ValueError
        A field breaks the rule documented on it; the message names it.
    """

    length_mm: float | tuple[float, ...]
    """Of a beam, or of a structure along each axis; sensors and contacts stand at 0 to `length_mm`."""
    load_mm: Floats
    """(loads, axes) places of an even grid, ascending, or (loads,) positions; contacts lie within it."""
    force_n: tuple[float, float]
    """Range of forces, positive; equal ends if the force is exact."""
    at: Callable[[Floats, Floats], Floats]
    """From places of sensors (sensors, axes) and loads (loads, axes), both in mm, to the influence matrix (loads,
    sensors) in mm/N. Both come in any order, and anywhere on 0 to `length_mm`: equal pitch, for example, puts sensors
    where rules allow none. All values are finite. So a table of measurements is interpolated over the whole length."""
    unit_mm_per_n: float = 1.0
    """Deflection per newton that counts as 1 in a dimensionless score, positive; l^3/(EI) of a beam."""
    interpolation: Interpolation | None = None
    """Uncertainty between the places of a table; None: `at` is exact."""

    def __post_init__(self) -> None:
        load = np.array(self.load_mm, dtype=np.float64)  # a copy: the caller may change its array
        object.__setattr__(self, "load_mm", load)
        self._require("length_mm", bool(np.all((self.size_mm > 0) & (self.size_mm < math.inf))), "a positive number")
        is_beam, axes = np.ndim(self.length_mm) == 0, len(self.size_mm)
        self._require("load_mm", load.ndim in (1, 2) and load.size > axes, "a list of two positions or more")
        self._require("load_mm", load.size == axes * len(load), f"a list of places with {axes} numbers each")
        self._require("load_mm", bool(np.isfinite(load).all()), "finite")
        places = self.place_mm
        self._require("load_mm", bool(places.min() >= 0 and np.all(places <= self.size_mm)), "at 0 to length_mm")
        self._require("load_mm", _is_even(places, self.diagonal_mm), "ascending and evenly spaced")
        low, high = self.force_n
        self._require("force_n", 0 < low <= high < math.inf, "positive, the first no larger than the second")
        self._require("unit_mm_per_n", 0 < self.unit_mm_per_n < math.inf, "a positive number")
        object.__setattr__(self, "at", partial(_checked, self.at, axes, is_beam))
        # A few values, in no order, so that a function with swapped arguments is refused at once.
        self.at(np.array([0.7, 0.2, 0.5])[:, None] * self.size_mm, places[[-1, 0]])

    def __repr__(self) -> str:
        """Return of what structure and contacts it is."""
        size = " x ".join(f"{length:g}" for length in self.size_mm)
        places = ", ".join(f"{low:g}..{high:g}" for low, high in self.extent.ranges_mm)
        forces = "..".join(f"{force:g}" for force in sorted(set(self.force_n)))
        return f"InfluenceFunction({size} mm, loads at {places} mm with {forces} N)"

    def _require(self, name: str, is_kept: bool, wanted: str) -> None:
        if not is_kept:
            raise ValueError(f"{name} of an influence function must be {wanted}, not {getattr(self, name)}")

    @property
    def size_mm(self) -> Floats:
        """Length along each axis, (axes,)."""
        return np.atleast_1d(np.asarray(self.length_mm, dtype=np.float64))

    @property
    def diagonal_mm(self) -> float:
        """Length of which errors are a percentage: that of a beam, the diagonal of a plate."""
        return math.hypot(*self.size_mm)

    @property
    def place_mm(self) -> Floats:
        """The places of the loads, (loads, axes)."""
        return in_rows(self.load_mm, len(self.size_mm))

    @property
    def extent(self) -> Extent:
        """Extent of the contacts."""
        ends = zip(self.place_mm.min(axis=0).tolist(), self.place_mm.max(axis=0).tolist(), strict=True)
        return Extent(tuple(ends))

    @property
    def position_mm(self) -> tuple[float, float]:
        """Range of contacts on a beam; ValueError if there are more axes than one."""
        return self.extent.range_mm

    def matrix(self, sensor_mm: Floats) -> Floats:
        """Return the influence matrix of sensors (sensors, axes) under all loads, (loads, sensors) in mm/N."""
        return self.at(sensor_mm, self.place_mm)

    def is_uncertain(self, tolerance_mm: float) -> bool:
        """True if `deviation` is more than nothing."""
        return tolerance_mm > 0 or self.interpolation is not None

    def deviation(self, sensor_mm: Floats, load_mm: Floats, tolerance_mm: float) -> Floats:
        """Return the change of the influence by a tolerance of the sensors' places, (loads, sensors, axes) in mm/N.

        These are standard deviations, positive where the influence grows with the coordinate of the sensor: of several
        loads at once they add up, as a sensor is at one place only. What the interpolation of a table leaves stands
        behind them, as if it were one more axis, and then how far loads do not repeat. Errors as `at`.
        """
        sensor_mm = in_rows(sensor_mm, len(self.size_mm))
        deviation = np.empty((len(load_mm), *sensor_mm.shape))
        for axis, step in enumerate(tolerance_mm * np.eye(sensor_mm.shape[1])):
            left, right = (np.clip(sensor_mm + side * step, 0.0, self.size_mm) for side in (-1, 1))
            change = self.at(right, load_mm) - self.at(left, load_mm)
            # At an end of the beam the sensor can move to one side only.
            apart = np.maximum((right - left).sum(axis=1), np.finfo(np.float64).tiny)
            deviation[..., axis] = change * (tolerance_mm / apart)
        if self.interpolation is None:
            return deviation
        sources = self.interpolation.deviation_at, self.interpolation.repeats
        left = [source(sensor_mm, load_mm)[..., None] for source in sources if source is not None]
        return np.concatenate([deviation, *left], axis=2)

    def variance(self, sensor_mm: Floats, load_mm: Floats, tolerance_mm: float) -> Floats:
        """Return the variance of the influence, (loads, sensors) in (mm/N)^2; arguments as `deviation`."""
        variance: Floats = (self.deviation(sensor_mm, load_mm, tolerance_mm) ** 2).sum(axis=2)
        return variance

    def shared(self, sensor_mm: Floats) -> Floats | None:
        """Return the loadings (sensors, sources) of what a table leaves open, as `Interpolation` has them; None: none.

        They are of the whole `variance`: sensors that were measured have no tolerance of their places.
        """
        if self.interpolation is None or self.interpolation.shared_at is None:
            return None
        loadings = self.interpolation.shared_at(in_rows(sensor_mm, len(self.size_mm)))
        return loadings if loadings.shape[1] else None


def _is_even(load: Floats, diagonal_mm: float) -> bool:
    """True if loads (loads, axes) are all places of an even grid in their order."""
    ticks = [np.unique(column) for column in load.T]
    if math.prod(len(tick) for tick in ticks) != len(load) or not np.array_equal(grid_of(ticks), load):
        return False
    steps = [np.diff(tick) for tick in ticks if len(tick) > 1]
    rounding = 16 * float(np.spacing(diagonal_mm))
    return len(steps) == len(ticks) and all(np.ptp(step) <= EVEN * float(step.mean()) + rounding for step in steps)


def _checked(
    at: Callable[[Floats, Floats], Floats], axes: int, is_beam: bool, sensor_mm: Floats, load_mm: Floats
) -> Floats:
    """Return what the user's function returns; ValueError unless these are finite numbers of the right shape."""
    sensor_mm, load_mm = (in_rows(places, axes) for places in (sensor_mm, load_mm))
    sensors, loads = (sensor_mm[:, 0], load_mm[:, 0]) if is_beam else (sensor_mm, load_mm)
    matrix, wanted = array_of(at(sensors, loads), "at of an influence function"), (len(load_mm), len(sensor_mm))
    must = "at of an influence function must return finite values of shape (loads, sensors)"
    if matrix.shape != wanted:
        raise ValueError(f"{must}, here {wanted}, not {matrix.shape}")
    if not np.isfinite(matrix).all():
        load, sensor = np.argwhere(~np.isfinite(matrix))[0]
        places = (", ".join(f"{number:g}" for number in place) for place in (sensor_mm[sensor], load_mm[load]))
        raise ValueError(
            f"{must}, not {matrix[load, sensor]} for a sensor at {next(places)} and a load at {next(places)} mm"
        )
    return matrix


def even_loads_mm(ranges_mm: Sequence[tuple[float, float]], size_mm: Sequence[float]) -> Floats:
    """Return even places of loads (loads, axes) over ranges of contacts, or positions (loads,) on one axis.

    On one axis they are every 1/400 of the length, as in the paper, on two in about square cells.
    """
    if len(size_mm) == 1:
        ((low, high),) = ranges_mm
        return np.linspace(low, high, max(1, round((high - low) / size_mm[0] * LOADS)) + 1)
    step_mm = math.sqrt(math.prod(size_mm) / PLATE_LOADS)
    return grid_of([np.linspace(low, high, max(1, round((high - low) / step_mm)) + 1) for low, high in ranges_mm])


@dataclass(frozen=True, repr=False)
class Travel(Rounded):
    """How far the contacts of a scene move a structure, anywhere on it."""

    lift_mm: float
    """Against the direction of the largest force, 0 or more; a beam on two supports never lifts, an overhang does."""
    fall_mm: float
    """In the direction of the largest force, 0 or more."""
    slope: float
    """Largest slope under the largest force, in rad."""
    force_n: float
    """The largest force."""

    @property
    def largest_mm(self) -> float:
        """Largest deflection in either direction."""
        return max(self.lift_mm, self.fall_mm)


def travel_of(influence: InfluenceFunction) -> Travel:
    """Return the travel of a structure; SceneError if it is beyond what can be computed."""
    force_n = influence.force_n[1]
    if len(influence.size_mm) > 1:
        return _travel_of_plate(influence, force_n)
    points = np.linspace(0.0, influence.diagonal_mm, POINTS)
    with np.errstate(over="ignore"):
        shapes = influence.matrix(points[:, None]) * force_n
    if not np.all(np.isfinite(shapes)):
        message = "the deflection at the largest force is beyond what can be computed; check contact.force_n and beam"
        raise SceneError(message)
    slope = float(np.abs(np.diff(shapes, axis=1)).max() / (points[1] - points[0]))
    return Travel(max(0.0, -float(shapes.min())), max(0.0, float(shapes.max())), slope, force_n)


def _travel_of_plate(influence: InfluenceFunction, force_n: float) -> Travel:
    extent = Extent(tuple((0.0, float(length)) for length in influence.size_mm))
    ticks, loads = extent.ticks(PLATE_POINTS), influence.place_mm
    some = loads[np.linspace(0, len(loads) - 1, min(len(loads), PLATE_POINTS)).round().astype(np.intp)]
    shapes = (influence.at(grid_of(ticks), some) * force_n).reshape(len(some), *map(len, ticks))
    if not np.all(np.isfinite(shapes)):
        raise SceneError("the deflection at the largest force is beyond what can be computed; check contact.force_n")
    slopes = [
        float(np.abs(np.diff(shapes, axis=1 + axis)).max() / (along[1] - along[0])) for axis, along in enumerate(ticks)
    ]
    return Travel(max(0.0, -float(shapes.min())), max(0.0, float(shapes.max())), math.hypot(*slopes), force_n)


def check_own(
    influence: InfluenceFunction,
    ranges_mm: tuple[tuple[float, float], ...],
    force_n: tuple[float, float],
    size_mm: Floats | None = None,
) -> None:
    """Raise SceneError unless what a user gives is an influence function for these contacts, of this size if any."""
    require(influence, InfluenceFunction, "influence", "an InfluenceFunction")
    if (axes := influence.extent.axes) != len(ranges_mm):
        words = {1: "one, position_mm", 2: "two, x_mm and y_mm"}
        raise SceneError(f"influence: its number of axes is {axes}, but contact has {words[len(ranges_mm)]}")
    own_size_mm = influence.size_mm.tolist()
    for name, own, scene in (
        ("length_mm", own_size_mm, own_size_mm if size_mm is None else size_mm.tolist()),
        *(("load_mm", *pair) for pair in zip(influence.extent.ranges_mm, ranges_mm, strict=True)),
        ("force_n", influence.force_n, force_n),
    ):
        if not np.allclose(own, scene, rtol=EVEN, atol=0.0 if name == "force_n" else EVEN * influence.diagonal_mm):
            ours, theirs = (" to ".join(f"{value:.12g}" for value in values) for values in (own, scene))
            raise SceneError(f"influence: its {name} is {ours}, but that of the scene is {theirs}; make them equal")
