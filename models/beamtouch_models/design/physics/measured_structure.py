"""A measured structure: the influence that is fitted to its table, and how well that is known."""

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import RegularGridInterpolator
from scipy.spatial import KDTree
from scipy.spatial.distance import cdist

from beamtouch_models.arrays import Floats, Indices
from beamtouch_models.design.physics.characteristic_fit import Characteristic, mean_at_places
from beamtouch_models.design.physics.influence_function import InfluenceFunction, Interpolation, even_loads_mm
from beamtouch_models.design.physics.place_table import PlaceTable
from beamtouch_models.design.physics.shared_errors import loadings_of
from beamtouch_models.design.physics.smooth_fit import SmoothFit
from beamtouch_models.design.physics.table_doubts import FittedAt, find_fault
from beamtouch_models.design.physics.theory_fit import KnownLoads, Theory, TheoryFit
from beamtouch_models.design.scene import Scene
from beamtouch_models.design.scene.measured_loads import parse_loads
from beamtouch_models.errors import SceneError
from beamtouch_models.numbers import places_within
from beamtouch_models.places import Extent, grid_of, in_rows, positions_of

INSIDE, OUTSIDE = {1: 201, 2: 64}, {1: 41, 2: 9}
"""Places along each axis at which the fit is evaluated, within the range of contacts and on either side of it, by the
number of axes; it is interpolated between them."""
DRAWN = 450
"""Most places at which a structure is drawn; between them, its difference from the mean is interpolated."""
BEYOND = 1.05
"""A force may exceed the heaviest load of curved sensors by so much."""
CONTACTS, FORCES = {1: 101, 2: 33**2}, 21
"""Places, by the number of axes, and forces of the contacts over which the slope of curved sensors is averaged."""
Ranges = tuple[tuple[float, float], ...]


@dataclass(frozen=True, eq=False)
class MeasuredStructure:
    """A structure whose influence was measured at some sensors; places are in mm from its left end or its corner."""

    size_mm: tuple[float, ...]
    """Length along each axis."""
    names: tuple[str, ...]
    sensor_mm: Floats
    """(sensors, axes), ascending by the first axis, then by the next."""
    ticks_mm: tuple[Floats, ...]
    """The coordinates along each axis of the places at which the fit was evaluated."""
    mean: PlaceTable
    """From places of loads (..., axes) to the influence (..., sensors) in mm/N."""
    between: RegularGridInterpolator
    """The same of the standard deviation that the fit leaves."""
    repeatability: Floats
    """(sensors,) standard deviation by which the influence differs when a load is put on anew, in mm/N."""
    fit: SmoothFit | TheoryFit
    """Of the influence, to the table."""
    spacing_mm: float
    """Largest distance of a load from the next one; on one axis, to either side."""
    shares: Floats
    """(sensors,) part of the influence by which it differs from load to load as well."""
    loadings: Floats
    """(sensors, sources) of what the fit and the repeatability leave open, see `loadings_of`."""
    characteristics: tuple[Characteristic, ...] = ()
    """Of the sensors, if they are curved; the influence is that of straightened deflections."""
    scale: float = 1.0
    """Factor on the influence."""
    held_mm: tuple[float, ...] = ()
    """Its supports are not known."""

    @property
    def length_mm(self) -> float:
        """Length along the first axis."""
        return self.size_mm[0]

    @property
    def axes(self) -> int:
        """Number of axes."""
        return len(self.size_mm)

    def scaled(self, factor: float) -> "MeasuredStructure":
        """Return a structure that yields `factor` times as much."""
        return replace(self, scale=self.scale * factor)

    def draw(self, rng: np.random.Generator) -> "MeasuredStructure":
        """Draw a structure that agrees with the table; the mean of many is this one, and each is smooth."""
        nodes = math.prod(map(len, self.ticks_mm))
        apart = max(1, round((nodes / DRAWN) ** (1 / self.axes)))
        ticks = [np.union1d(along[::apart], along[-1:]) for along in self.ticks_mm]
        some = grid_of(ticks)
        away = PlaceTable(ticks, self.fit.draw(some, rng) - self.mean(some))
        return replace(self, mean=PlaceTable(self.ticks_mm, self.mean.values + away(grid_of(list(self.ticks_mm)))))

    def influence(self, sensor_mm: ArrayLike, load_mm: ArrayLike) -> Floats:
        """Return the influence (loads, sensors) in mm/N; each sensor is the nearest one that was measured.

        Places are (places, axes), or positions (places,) on one axis.
        """
        sensor, load = self._places_on(sensor_mm, "sensor_mm"), self._places_on(load_mm, "load_mm")
        matrix: Floats = self.scale * self.mean(load)[:, self.nearest(sensor)]
        return matrix

    def _places_on(self, values: ArrayLike, name: str) -> Floats:
        ends_mm = np.array(self.size_mm)
        return places_within(np.ravel(values) if self.axes == 1 else values, name, np.zeros(self.axes), ends_mm)

    def deviation(self, sensor_mm: Floats, load_mm: Floats) -> Floats:
        """Return the standard deviation (loads, sensors) that the fit leaves; places (..., axes) in mm."""
        deviation: Floats = self.scale * self.between(load_mm)[:, self.nearest(sensor_mm)]
        return deviation

    def scatter(self, sensor_mm: Floats, load_mm: Floats) -> Floats:
        """Return the standard deviation (loads, sensors) by which loads repeat; places (..., axes) in mm."""
        nearest = self.nearest(sensor_mm)
        moved = self.shares[nearest] * self.mean(load_mm)[:, nearest]
        scatter: Floats = self.scale * np.hypot(moved, self.repeatability[nearest])
        return scatter

    def variance(self, sensor_mm: Floats, load_mm: Floats) -> Floats:
        """Return the variance (loads, sensors) of the influence, of both; places (..., axes) in mm."""
        variance: Floats = self.deviation(sensor_mm, load_mm) ** 2 + self.scatter(sensor_mm, load_mm) ** 2
        return variance

    def shared(self, sensor_mm: Floats) -> Floats:
        """Return the loadings (places, sources) of the sensors at places."""
        shared: Floats = self.loadings[self.nearest(sensor_mm)]
        return shared

    def steepest(self, contacts_mm: Ranges, force_n: tuple[float, float]) -> float:
        """Return the factor by which errors of curved sensors grow when these are straightened.

        It is that of the sensor with the largest, at rest or over contacts, whichever is larger: a sensor that shows
        less and less is steepest under the heaviest load.
        """
        places, forces = Extent(contacts_mm).grid(CONTACTS[self.axes]), np.linspace(*force_n, FORCES)
        straight_mm = forces[:, None, None] * self.influence(self.sensor_mm, places)
        return max(
            max(curved.at_rest, float(np.sqrt(np.mean(curved.slope(curved.show(one_mm)) ** 2))))
            for curved, one_mm in zip(self.characteristics, np.moveaxis(straight_mm, -1, 0), strict=True)
        )

    def nearest(self, sensor_mm: Floats) -> Indices:
        """Return the sensors (places,) that stand nearest to places."""
        nearest: Indices = cdist(in_rows(sensor_mm, self.axes), self.sensor_mm).argmin(axis=1)
        return nearest


def measured_structure_of(scene: Scene) -> MeasuredStructure:
    """Return the measured structure of a scene.

    Raises
    ------
    SceneError
        The loads are too far apart for the scene's contacts, contradict each other, or tell nothing.
    """
    measured = scene.measured
    if measured is None:
        raise SceneError("measured is missing; add it")
    noise_mm, strongest_n = _noise_mm(scene) if measured.curved else None, max(scene.contact.force_range_n)
    if measured.curved and strongest_n > BEYOND * (tried_n := float(measured.loads.force_n.max())):
        raise SceneError(
            f"contact.force_n goes to {strongest_n:g} N, but the heaviest load of the table is {tried_n:g} N, and "
            f"nobody knows what a curved sensor shows beyond it; end contact.force_n at {tried_n:g}, or record heavier "
            "loads"
        )
    places = tuple((name, tuple(np.atleast_1d(place).tolist())) for name, place in measured.places_mm.items())
    if measured.theory is not None:
        error_mm = math.hypot(scene.sensors.noise_mm or 0.0, scene.sensors.zero_drift_mm or 0.0)
        tables = measured.influence, measured.theory
        contacts_mm, size_mm = scene.contact.ranges_mm, measured.size_mm
        return _structure_by_theory(tables, places, size_mm, contacts_mm, error_mm, curved=measured.curved)
    return _structure(measured.influence, places, measured.size_mm, scene.contact.ranges_mm, noise_mm)


def _noise_mm(scene: Scene) -> float:
    """Return how far a sensor at rest may be off, noise and zero, to which a characteristic is fitted."""
    sensors = scene.sensors
    if sensors.noise_mm is None or not sensors.noise_mm + (sensors.zero_drift_mm or 0.0) > 0:
        raise SceneError("measured.curved needs sensors.noise_mm, as what a sensor shows begins beyond it; state it")
    return math.hypot(sensors.noise_mm, sensors.zero_drift_mm or 0.0)


@lru_cache(maxsize=8)  # a scene is asked for it all the time
def _structure(
    text: str,
    sensors_mm: tuple[tuple[str, tuple[float, ...]], ...],
    size_mm: tuple[float, ...],
    contacts_mm: Ranges,
    noise_mm: float | None,
) -> MeasuredStructure:
    loads = parse_loads(text, "the table")
    in_order = sorted(sensors_mm, key=lambda sensor: sensor[1])
    names = tuple(name for name, _ in in_order)
    columns = [loads.names.index(name) for name in names]
    place_mm, force_n = loads.place_mm, loads.force_n
    values, shares = loads.influence_mm_per_n[:, columns], np.zeros(len(names))
    characteristics: tuple[Characteristic, ...] = ()
    if noise_mm is not None:
        shown_mm = loads.deflection_mm[:, columns]
        characteristics = tuple(
            Characteristic.fit(name, place_mm, force_n, shown, noise_mm)
            for name, shown in zip(names, shown_mm.T, strict=True)
        )
        place_mm, values, shares = mean_at_places(place_mm, force_n, shown_mm, characteristics, noise_mm)
        force_n = np.ones(len(place_mm))
    fit = SmoothFit.of(place_mm, values, force_n)
    along = zip(contacts_mm, size_mm, strict=True)
    ticks = tuple(_ticks_mm(ends, length_mm, len(size_mm)) for ends, length_mm in along)
    at_mm = grid_of(list(ticks))
    mean, between = fit.at(at_mm)
    low, high = np.array(contacts_mm).T
    is_contact = np.all((at_mm >= low) & (at_mm <= high), axis=1)
    contacts = FittedAt(at_mm[is_contact], mean[is_contact], between[is_contact])
    if fault := find_fault(fit, values, force_n, contacts, names, loads.unit):
        raise SceneError(f"measured.influence: {fault}")
    return MeasuredStructure(
        size_mm,
        names,
        np.array([place for _, place in in_order]),
        ticks,
        *_between_ticks(ticks, mean, between),
        fit.repeatability,
        fit,
        _spacing_mm(loads.place_mm),
        shares,
        loadings_of(fit.correlation),
        characteristics,
    )


@lru_cache(maxsize=8)  # as `_structure`
def _structure_by_theory(
    tables: tuple[str, str],
    sensors_mm: tuple[tuple[str, tuple[float, ...]], ...],
    size_mm: tuple[float, ...],
    contacts_mm: Ranges,
    noise_mm: float,
    *,
    curved: bool,
) -> MeasuredStructure:
    loads, table = (parse_loads(text, name) for text, name in zip(tables, ("the table", "the theory"), strict=True))
    in_order = sorted(sensors_mm, key=lambda sensor: sensor[1])
    names = tuple(name for name, _ in in_order)
    columns = [table.names.index(name) for name in names]
    theory = Theory.of(positions_of(table.place_mm), table.influence_mm_per_n[:, columns])
    position_mm = positions_of(loads.place_mm)
    shown_mm = loads.deflection_mm[:, [loads.names.index(name) for name in names]]
    known = KnownLoads(position_mm, loads.force_n, shown_mm, theory.at(position_mm))
    if curved:
        known.check_curved(names, noise_mm)
    (low_mm, high_mm), ends_mm = contacts_mm[0], theory.position_mm[[0, -1]].tolist()
    if low_mm < ends_mm[0] or high_mm > ends_mm[1]:
        raise SceneError(
            f"contact.position_mm goes from {low_mm:g} to {high_mm:g} mm, but measured.theory from {ends_mm[0]:g} to "
            f"{ends_mm[1]:g} mm; compute it over the whole range"
        )
    fit = TheoryFit.of(theory, known, noise_mm, curved=curved)
    fit.check(known, noise_mm, names, loads.unit)
    ticks = (_ticks_mm(contacts_mm[0], size_mm[0], 1),)
    mean, between = fit.at(grid_of(list(ticks)))
    return MeasuredStructure(
        size_mm,
        names,
        np.array([place for _, place in in_order]),
        ticks,
        *_between_ticks(ticks, mean, between),
        fit.repeatability,
        fit,
        float(np.diff(theory.position_mm).max()),
        np.zeros(len(names)),
        np.zeros((len(names), 0)),
        fit.gains.characteristics,
    )


def _between_ticks(
    ticks: tuple[Floats, ...], mean: Floats, between: Floats
) -> tuple[PlaceTable, RegularGridInterpolator]:
    """Return what interpolates a fit's mean and standard deviation between the places where it was evaluated."""
    on_grid = between.reshape(*map(len, ticks), *between.shape[1:])
    return PlaceTable(ticks, mean), RegularGridInterpolator(ticks, on_grid, bounds_error=False, fill_value=None)


def _ticks_mm(contacts_mm: tuple[float, float], length_mm: float, axes: int) -> Floats:
    """Return where the fit is evaluated, most of it where contacts are: they may take a small part of the length."""
    low, high = contacts_mm
    outside = np.linspace(0.0, low, OUTSIDE[axes]), np.linspace(high, length_mm, OUTSIDE[axes])
    return np.unique(np.concatenate([*outside, np.linspace(low, high, INSIDE[axes])]))


def _spacing_mm(place_mm: Floats) -> float:
    """Return the largest distance of neighbouring loads."""
    places = np.unique(place_mm, axis=0)
    if places.shape[1] == 1:
        return float(np.diff(places[:, 0]).max())
    return float(KDTree(places).query(places, k=2)[0][:, 1].max())


def measured_influence_of(scene: Scene) -> InfluenceFunction:
    """Return the influence function of a scene's measured structure; SceneError as `measured_structure_of`."""
    structure, contact = measured_structure_of(scene), scene.contact
    loads_mm = even_loads_mm(contact.ranges_mm, structure.size_mm)
    largest = float(np.abs(structure.influence(structure.sensor_mm, loads_mm)).max())
    left = Interpolation(
        structure.deviation, structure.spacing_mm, repeats=structure.scatter, shared_at=structure.shared
    )
    size_mm = structure.length_mm if structure.axes == 1 else structure.size_mm
    return InfluenceFunction(size_mm, loads_mm, contact.force_range_n, structure.influence, largest, left)
