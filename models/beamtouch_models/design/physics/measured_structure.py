"""A measured structure: the influence that is fitted to its table, and how well that is known."""

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline

from beamtouch_common.digits import digits
from beamtouch_models.arrays import Bools, Floats, Indices
from beamtouch_models.design.physics.characteristic_fit import Characteristic, mean_at_places
from beamtouch_models.design.physics.influence_function import InfluenceFunction, Interpolation, even_loads_mm
from beamtouch_models.design.physics.smooth_fit import SmoothFit
from beamtouch_models.design.physics.theory_fit import KnownLoads, Theory, TheoryFit
from beamtouch_models.design.scene import Scene
from beamtouch_models.design.scene.measured_loads import parse_loads
from beamtouch_models.errors import SceneError
from beamtouch_models.numbers import places_in
from beamtouch_models.places import on_axis, positions_of

PLACES, PLACES_OUTSIDE = 201, 41
"""Places along the structure at which the fit is evaluated; it is interpolated between them."""
COARSE = 0.1
"""Largest part of the influence that may be unknown anywhere in the range of contacts. A sensor that is known no better
tells places hardly better than whether something touches."""
UNSTEADY = 0.2
"""Largest part of the influence by which a load may differ when it is put on anew."""
BEYOND = 1.05
"""A force may exceed the heaviest load of curved sensors by so much."""
CONTACTS, FORCES = 101, 21
"""Places and forces of the contacts over which the slope of curved sensors is averaged."""
MORE = 40
"""Largest number of further loads that a message asks for."""
SURELY = 8.0
"""Deviations from what the others say by which a load contradicts them."""
ENOUGH = 8
"""Loads with which one that contradicts the others can be told, and scatter from too few of them."""


@dataclass(frozen=True, eq=False)
class MeasuredStructure:
    """A structure whose influence was measured at some sensors; positions are in mm from its left end."""

    length_mm: float
    names: tuple[str, ...]
    sensor_mm: Floats
    """(sensors,), ascending."""
    mean: CubicSpline
    """From positions of loads (...) to the influence (..., sensors) in mm/N."""
    at_mm: Floats
    """(places,) at which the deviation is known."""
    between: Floats
    """(places, sensors) standard deviation of the influence that the fit leaves, in mm/N."""
    repeatability: Floats
    """(sensors,) standard deviation by which the influence differs when a load is put on anew, in mm/N."""
    fit: SmoothFit | TheoryFit
    """Of the influence, to the table."""
    spacing_mm: float
    """Largest distance of neighbouring loads."""
    shares: Floats
    """(sensors,) part of the influence by which it differs from load to load as well."""
    characteristics: tuple[Characteristic, ...] = ()
    """Of the sensors, if they are curved; the influence is that of straightened deflections."""
    scale: float = 1.0
    """Factor on the influence."""
    held_mm: tuple[float, ...] = ()
    """Its supports are not known."""

    def scaled(self, factor: float) -> "MeasuredStructure":
        """Return a structure that yields `factor` times as much."""
        return replace(self, scale=self.scale * factor)

    def draw(self, rng: np.random.Generator) -> "MeasuredStructure":
        """Draw a structure that agrees with the table; the mean of many is this one, and each is smooth."""
        return replace(self, mean=CubicSpline(self.at_mm, self.fit.draw(on_axis(self.at_mm), rng)))

    def influence(self, sensor_mm: ArrayLike, load_mm: ArrayLike) -> Floats:
        """Return the influence (loads, sensors) in mm/N; each sensor is the nearest one that was measured."""
        sensor, load = (places_in(mm, "sensor_mm", self.length_mm) for mm in (sensor_mm, load_mm))
        matrix: Floats = self.scale * self.mean(load)[:, self.nearest(sensor)]
        return matrix

    def deviation(self, sensor_mm: Floats, load_mm: Floats) -> Floats:
        """Return the standard deviation (loads, sensors) that the fit leaves; places (..., 1) in mm."""
        columns, load = self.nearest(positions_of(sensor_mm)), positions_of(load_mm)
        return self.scale * np.stack([np.interp(load, self.at_mm, self.between[:, one]) for one in columns], axis=1)

    def scatter(self, sensor_mm: Floats, load_mm: Floats) -> Floats:
        """Return the standard deviation (loads, sensors) by which loads repeat; places (..., 1) in mm."""
        nearest = self.nearest(positions_of(sensor_mm))
        moved = self.shares[nearest] * self.mean(positions_of(load_mm))[:, nearest]
        scatter: Floats = self.scale * np.hypot(moved, self.repeatability[nearest])
        return scatter

    def variance(self, sensor_mm: Floats, load_mm: Floats) -> Floats:
        """Return the variance (loads, sensors) of the influence, of both; places (..., 1) in mm."""
        variance: Floats = self.deviation(sensor_mm, load_mm) ** 2 + self.scatter(sensor_mm, load_mm) ** 2
        return variance

    def steepest(self, contacts_mm: tuple[float, float], force_n: tuple[float, float]) -> float:
        """Return the factor by which errors of curved sensors grow when these are straightened, 1 for straight ones.

        It is that of the sensor with the largest, at rest or over contacts, whichever is larger: a sensor that shows
        less and less is steepest under the heaviest load.
        """
        places, forces = np.linspace(*contacts_mm, CONTACTS), np.linspace(*force_n, FORCES)
        straight_mm = forces[:, None, None] * self.influence(self.sensor_mm, places)
        factors = [
            max(curved.at_rest, float(np.sqrt(np.mean(curved.slope(curved.show(one_mm)) ** 2))))
            for curved, one_mm in zip(self.characteristics, np.moveaxis(straight_mm, -1, 0), strict=True)
        ]
        return max(factors, default=1.0)

    def nearest(self, sensor_mm: Floats) -> Indices:
        """Return the sensors (positions,) that stand nearest to positions."""
        nearest: Indices = np.abs(np.reshape(sensor_mm, (-1, 1)) - self.sensor_mm).argmin(axis=1)
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
    places = tuple(measured.places_mm.items())
    if measured.theory is not None:
        error_mm = math.hypot(scene.sensors.noise_mm or 0.0, scene.sensors.zero_drift_mm or 0.0)
        tables = measured.influence, measured.theory
        return _structure_by_theory(
            tables, places, measured.end_mm, scene.contact.position_mm, error_mm, curved=measured.curved
        )
    return _structure(measured.influence, places, measured.end_mm, scene.contact.position_mm, noise_mm)


def _noise_mm(scene: Scene) -> float:
    """Return how far a sensor at rest may be off, noise and zero, to which a characteristic is fitted."""
    sensors = scene.sensors
    if sensors.noise_mm is None or not sensors.noise_mm + (sensors.zero_drift_mm or 0.0) > 0:
        raise SceneError("measured.curved needs sensors.noise_mm, as what a sensor shows begins beyond it; state it")
    return math.hypot(sensors.noise_mm, sensors.zero_drift_mm or 0.0)


@lru_cache(maxsize=8)
def _structure(
    text: str,
    sensors_mm: tuple[tuple[str, float], ...],
    length_mm: float,
    contacts_mm: tuple[float, float],
    noise_mm: float | None,
) -> MeasuredStructure:
    loads = parse_loads(text, "the table")
    in_order = sorted(sensors_mm, key=lambda sensor: sensor[1])
    names = tuple(name for name, _ in in_order)
    columns = [loads.names.index(name) for name in names]
    position_mm, force_n = loads.position_mm, loads.force_n
    values, shares = loads.influence_mm_per_n[:, columns], np.zeros(len(names))
    characteristics: tuple[Characteristic, ...] = ()
    if noise_mm is not None:
        shown_mm = loads.deflection_mm[:, columns]
        characteristics = tuple(
            Characteristic.fit(name, position_mm, force_n, shown, noise_mm)
            for name, shown in zip(names, shown_mm.T, strict=True)
        )
        position_mm, values, shares = mean_at_places(position_mm, force_n, shown_mm, characteristics, noise_mm)
        force_n = np.ones(len(position_mm))
    fit = SmoothFit.of(on_axis(position_mm), values, force_n)
    if silent := [name for name, shown in zip(names, values.T, strict=True) if np.count_nonzero(shown) <= 1]:
        raise SceneError(f"measured.influence: {silent[0]} shows 0 under all loads but one; check it, or take it out")
    at_mm = _grid_mm(contacts_mm, length_mm)
    mean, between = fit.at(on_axis(at_mm))
    is_contact = (at_mm >= contacts_mm[0]) & (at_mm <= contacts_mm[1])
    largest = np.sqrt(np.mean(mean[is_contact] ** 2, axis=0))
    if message := _contradiction(fit, values, force_n, largest, names, loads.unit):
        raise SceneError(f"measured.influence: {message}")
    scattered = _scattered(fit, largest, names)
    if scattered and len(values) >= ENOUGH:
        raise SceneError(f"measured.influence: {scattered}")
    share = _unknown(between**2, largest) * is_contact
    if share.max() > COARSE:
        raise SceneError(f"measured.influence: {_too_sparse(fit, at_mm, is_contact, largest, share)}")
    if scattered:
        raise SceneError(f"measured.influence: {scattered}")
    spacing_mm = float(np.diff(np.unique(loads.position_mm)).max())
    places_mm = np.array([place for _, place in in_order])
    return MeasuredStructure(
        length_mm,
        names,
        places_mm,
        CubicSpline(at_mm, mean),
        at_mm,
        between,
        fit.repeatability,
        fit,
        spacing_mm,
        shares,
        characteristics,
    )


@lru_cache(maxsize=8)
def _structure_by_theory(
    tables: tuple[str, str],
    sensors_mm: tuple[tuple[str, float], ...],
    length_mm: float,
    contacts_mm: tuple[float, float],
    noise_mm: float,
    *,
    curved: bool,
) -> MeasuredStructure:
    loads, table = (parse_loads(text, name) for text, name in zip(tables, ("the table", "the theory"), strict=True))
    in_order = sorted(sensors_mm, key=lambda sensor: sensor[1])
    names = tuple(name for name, _ in in_order)
    theory = Theory.of(table.position_mm, table.influence_mm_per_n[:, [table.names.index(name) for name in names]])
    known = KnownLoads(
        loads.position_mm,
        loads.force_n,
        loads.deflection_mm[:, [loads.names.index(name) for name in names]],
        theory.at(loads.position_mm),
    )
    if curved:
        known.check_curved(names, noise_mm)
    ends_mm = theory.position_mm[[0, -1]].tolist()
    if contacts_mm[0] < ends_mm[0] or contacts_mm[1] > ends_mm[1]:
        raise SceneError(
            f"contact.position_mm goes from {contacts_mm[0]:g} to {contacts_mm[1]:g} mm, but measured.theory from "
            f"{ends_mm[0]:g} to {ends_mm[1]:g} mm; compute it over the whole range"
        )
    fit = TheoryFit.of(theory, known, noise_mm, curved=curved)
    fit.check(known, noise_mm, names, loads.unit)
    at_mm = _grid_mm(contacts_mm, length_mm)
    mean, between = fit.at(on_axis(at_mm))
    return MeasuredStructure(
        length_mm,
        names,
        np.array([place for _, place in in_order]),
        CubicSpline(at_mm, mean),
        at_mm,
        between,
        fit.repeatability,
        fit,
        float(np.diff(theory.position_mm).max()),
        np.zeros(len(names)),
        fit.gains.characteristics,
    )


def _grid_mm(contacts_mm: tuple[float, float], length_mm: float) -> Floats:
    """Return where the fit is evaluated, most of it where contacts are: they may take a small part of the length."""
    low, high = contacts_mm
    outside = np.linspace(0.0, low, PLACES_OUTSIDE), np.linspace(high, length_mm, PLACES_OUTSIDE)
    return np.unique(np.concatenate([*outside, np.linspace(low, high, PLACES)]))


def _unknown(variance: Floats, largest: Floats) -> Floats:
    """Return the part of the influence (places,) of most sensors that is unknown, from its variance (places, sensors).

    A sensor of which nothing is known at some places has no say there; the others locate.
    """
    unknown: Floats = np.sqrt(np.median(variance / largest**2, axis=1))
    return unknown


def _contradiction(
    fit: SmoothFit, values: Floats, force_n: Floats, largest: Floats, names: tuple[str, ...], unit: str
) -> str:
    """Say which load contradicts the others; empty if none does."""
    if len(values) < ENOUGH:
        return ""
    suspect = int(np.abs(fit.left_out).max(axis=1).argmax())
    others = np.delete(np.arange(len(values)), suspect)
    without = SmoothFit.of(fit.place_mm[others], values[others], force_n[others])
    mean, deviation = (rows[0] for rows in without.at(fit.place_mm[[suspect]]))
    off = np.fmin(np.abs(values[suspect] - mean), _off_a_side(fit.place_mm, values, suspect))
    off[np.isnan(values[suspect])] = 0.0
    worst = int((off / np.hypot(deviation, without.repeatability)).argmax())
    if off[worst] <= max(SURELY * np.hypot(deviation, without.repeatability)[worst], COARSE * largest[worst]):
        return ""
    load = f"the load at {fit.place_mm[suspect, 0]:g} mm with {force_n[suspect]:g} N"
    both = values[suspect, worst], mean[worst]
    shown, said = (digits(float(per_newton * force_n[suspect]), 3) for per_newton in both)
    wrong = f"under {load}, {names[worst]} shows {shown} {unit}, but the others say {said}"
    return f"{wrong}; measure it again, or take it out"


def _off_a_side(place_mm: Floats, values: Floats, index: int) -> Floats:
    """Return by how much the values of a place (columns,) miss the straight line through its neighbours on one side.

    A load that stands on a kink, as under a string or above a strain gauge, surprises a smooth fit, but it lies on the
    line of one of its sides. A load that is wrong lies on neither.
    """
    along = place_mm.reshape(len(values), -1)
    off: Floats = np.full(values.shape[1], np.inf)
    if along.shape[1] > 1:
        return off
    here, distance = along[index, 0], along[:, 0] - along[index, 0]
    for side in (distance < 0, distance > 0):
        beside = np.unique(along[side, 0])
        near, next_to_it = beside[np.abs(beside - here).argsort()[:2]] if len(beside) > 1 else (here, here)
        if near != next_to_it:
            first, second = (values[along[:, 0] == place].mean(axis=0) for place in (near, next_to_it))
            line = first + (first - second) * (here - near) / (near - next_to_it)
            off = np.fmin(off, np.abs(values[index] - line))
    return off


def _scattered(fit: SmoothFit, largest: Floats, names: tuple[str, ...]) -> str:
    """Say which sensor shows something else each time; empty if none does."""
    scatter = fit.repeatability / largest
    worst = int(scatter.argmax())
    if scatter[worst] <= UNSTEADY:
        return ""
    if (scatter > UNSTEADY).all():
        return (
            f"all sensors repeat to {digits(100 * scatter.min(), 2)} % of what they show or worse, as if loads did not "
            "stand where the table says, or had other forces; correct the table, measure again, or state curved = true "
            "if heavy loads show less or more per newton than light ones"
        )
    return (
        f"{names[worst]} repeats to {digits(100 * scatter[worst], 2)} % of what it shows only, as if loads did not "
        f"stand where the table says; measure again what differs, or take {names[worst]} out"
    )


def _too_sparse(fit: SmoothFit, at_mm: Floats, is_contact: Bools, largest: Floats, share: Floats) -> str:
    """Say where the loads are too far apart, and how many more would do."""
    worst, contacts, more = int(share.argmax()), at_mm[is_contact], np.empty(0)
    unknown, there = share[worst], at_mm[worst]
    while unknown > COARSE and len(more) < MORE:
        more = np.append(more, there)
        shares = _unknown(fit.variance_with(on_axis(more), on_axis(contacts)), largest)
        unknown, there = shares.max(), contacts[shares.argmax()]
    would = f"{len(more)} loads more would do" if unknown <= COARSE else f"more than {MORE} loads more are needed"
    told = ", ".join(f"{place:g}" for place in sorted(more[:3].round().tolist()))
    percent = digits(100 * share[worst], 2)
    return (
        f"the loads are too far apart for contact.position_mm: at {at_mm[worst]:g} mm, {percent} % of the influence is "
        f"unknown, and more than {100 * COARSE:g} % is not trusted; {would}, first at {told} mm, or narrow "
        "contact.position_mm"
    )


def measured_influence_of(scene: Scene) -> InfluenceFunction:
    """Return the influence function of a scene's measured structure; SceneError as `measured_structure_of`."""
    structure, contact = measured_structure_of(scene), scene.contact
    loads_mm = even_loads_mm(contact.position_mm, structure.length_mm)
    largest = float(np.abs(structure.influence(structure.sensor_mm, loads_mm)).max())
    left = Interpolation(structure.deviation, structure.spacing_mm, repeats=structure.scatter)
    return InfluenceFunction(structure.length_mm, loads_mm, contact.force_range_n, structure.influence, largest, left)
