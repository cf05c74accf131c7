"""The influence matrix: deflection at each sensor per newton, for each load position."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from beamtouch_common.digits import digits
from beamtouch_models.arrays import Floats
from beamtouch_models.design.physics.closed_forms import patch_influence, point_influence, span_of
from beamtouch_models.design.physics.influence_function import InfluenceFunction
from beamtouch_models.design.physics.mesh import element_influence
from beamtouch_models.design.scene import Scene
from beamtouch_models.design.scene.beam import SMALLEST_NORMAL, Beam
from beamtouch_models.design.scene.plausible import ROUNDING, taken_mm
from beamtouch_models.errors import SceneError, require
from beamtouch_models.numbers import array_of, at_least, at_most, places_in

MAX_SENSOR_POSITIONS = 20_000
POINTS = 801
"""Points along the beam at which its travel is computed."""
MAX_SLOPE = 0.1
"""Largest slope in rad; beyond it, the factor (1 + slope^2)^(3/2) that small-angle theory neglects exceeds 1.5 %."""


def influence(beam: Beam, sensor_mm: ArrayLike, load_mm: ArrayLike, width_mm: float = 0.0) -> Floats:
    """Return the deflection at each sensor per newton, for each load position.

    Prismatic single spans are computed in closed form, all other beams with beam elements. Shear and a foundation are
    included only if the beam states them.

    Parameters
    ----------
    beam : the beam
    sensor_mm : (sensors,) positions in mm from the left end
    load_mm : (loads,) positions in mm from the left end
    width_mm : length over which a load presses evenly, 0 or more, centred at its position. If it reaches beyond an end
        of the beam, the whole force is spread over the part that lies on the beam.

    Returns
    -------
    (loads, sensors) in mm/N, positive in the direction of the load. Values below 1e-307 mm/N lose digits.

    Raises
    ------
    SceneError
        A position is not finite or not on the beam, or the beam cannot be computed: it exceeds the range of float64, or
        it is so uneven that the result is inaccurate.
    """
    sensor, load = places_in(sensor_mm, "sensor_mm", beam.length_mm), places_in(load_mm, "load_mm", beam.length_mm)
    low, high = np.maximum(load - width_mm / 2, 0.0), np.minimum(load + width_mm / 2, beam.length_mm)
    span = span_of(beam, float(min(sensor.min(), low.min())), float(max(sensor.max(), high.max())))
    if span is None:
        shape = element_influence(beam, sensor, low, high)
    elif width_mm == 0:
        shape = point_influence(span, sensor, load)
    else:
        shape = patch_influence(span, sensor, low, high)
    scale = _deflection_unit(beam.length_mm if span is None else span.length_mm, beam.rigidity_n_mm2)
    with np.errstate(over="ignore"):
        matrix: Floats = scale * shape
    if not np.all(np.isfinite(matrix)):
        raise SceneError("beam: its deflection is beyond what can be computed; check length and rigidity")
    return matrix


def influence_matrix(scene: Scene, sensor_mm: ArrayLike, load_mm: ArrayLike) -> Floats:
    """Return the deflection at each sensor per newton, for each place of a scene's contact.

    Parameters
    ----------
    scene : the scene
    sensor_mm : (sensors,) positions in mm from the left end
    load_mm : (loads,) positions in mm from the left end

    Returns
    -------
    (loads, sensors) in mm/N, positive in the direction of the load.

    Raises
    ------
    SceneError
        A position is not on the beam, or the beam cannot be computed.

    Examples
    --------
    >>> influence_matrix(scene, [100, 200], [200]).round(4)
    array([[0.0776, 0.1129]])
    """
    require(scene, Scene, "scene", "what read_scene or make_scene returns")
    return influence(scene.beam, sensor_mm, load_mm, scene.contact.width_mm)


def influence_of(scene: Scene) -> InfluenceFunction:
    """Return the influence function of a scene; its unit is l^3/(EI), with EI of the stiffest section."""
    return InfluenceFunction(
        scene.beam.length_mm,
        load_positions_mm(scene),
        scene.contact.force_range_n,
        partial(influence_matrix, scene),
        _deflection_unit(scene.beam.length_mm, scene.beam.rigidity_n_mm2),
    )


def interpolate_influence(
    scene: Scene, sensor_mm: ArrayLike, load_mm: ArrayLike, matrix: ArrayLike
) -> InfluenceFunction:
    """Return an influence function that interpolates a table, for the contacts of a scene.

    The table is measured, or comes from another program. Between its entries, cubic splines interpolate.

    Parameters
    ----------
    scene : states the length of the beam, and the contacts
    sensor_mm : (sensors,) ascending positions of the table's columns; the first is 0 and the last the end of the beam,
        so that a sensor may stand anywhere. Over a support the entries are 0.
    load_mm : (loads,) ascending positions of its rows, at least over the range of the scene's contacts
    matrix : (loads, sensors) deflection in mm per newton

    Raises
    ------
    SceneError
        An argument is not as its line says; the message names it.

    Examples
    --------
    >>> places = [0, 100, 200, 300, 400]
    >>> own = interpolate_influence(scene, places, places, 2 * influence_matrix(scene, places, places))
    >>> print(resolve(scene, influence=own).layout([130, 270]).limit(draws=500), "mm, as it yields twice as much")
    1.96 +- 0.009 mm, as it yields twice as much
    """
    require(scene, Scene, "scene", "what read_scene or make_scene returns")
    from scipy.interpolate import RectBivariateSpline  # noqa: PLC0415  # slow to import, and only scripts need it

    length_mm, (low, high) = scene.beam.length_mm, scene.contact.position_mm
    sensor, load = places_in(sensor_mm, "sensor_mm", length_mm), places_in(load_mm, "load_mm", length_mm)
    table = array_of(matrix, "matrix")
    for name, places, start, end in (("sensor_mm", sensor, 0.0, length_mm), ("load_mm", load, low, high)):
        if len(places) < 2 or np.diff(places).min() <= 0 or places[0] > start or places[-1] < end:
            message = f"{name}: give two or more ascending places, the first at {start:g} mm, the last at {end:g} mm"
            raise SceneError(message)
    if table.shape != (len(load), len(sensor)) or not np.isfinite(table).all():
        raise SceneError(f"matrix: give {len(load)} rows, one for each load, of {len(sensor)} finite numbers")
    spline = RectBivariateSpline(load, sensor, table, kx=min(3, len(load) - 1), ky=min(3, len(sensor) - 1), s=0)

    def at(sensor_mm: Floats, load_mm: Floats) -> Floats:
        values: Floats = spline(np.asarray(load_mm)[:, None], np.asarray(sensor_mm)[None, :], grid=False)
        return values

    unit = _deflection_unit(length_mm, scene.beam.rigidity_n_mm2)
    return InfluenceFunction(length_mm, load_positions_mm(scene), scene.contact.force_range_n, at, unit)


def _deflection_unit(length_mm: float, rigidity_n_mm2: float) -> float:
    """Return l^3/(EI), without an intermediate overflow."""
    length, power = math.frexp(length_mm)
    rigidity, under = math.frexp(rigidity_n_mm2)
    try:
        unit = math.ldexp(length * length * length / rigidity, 3 * power - under)
    except OverflowError:
        unit = math.inf
    if not SMALLEST_NORMAL <= unit < math.inf:
        raise SceneError(
            f"beam: {length_mm:g} mm long with a rigidity of {rigidity_n_mm2:g} N mm^2, it deflects beyond what can be "
            "computed; check length_mm, width_mm, thickness_mm and the modulus"
        )
    return unit


def load_positions_mm(scene: Scene) -> Floats:
    """Return the load positions of the influence matrix: every 1/400 of the length, as in the paper."""
    low, high = scene.contact.position_mm
    steps = max(1, round((high - low) / scene.beam.length_mm * 400))
    return np.linspace(low, high, steps + 1)


def sensor_positions_mm(scene: Scene) -> Floats:
    """Return the positions that a sensor may take, ascending: those of the grid with room for a housing, and the fixed.

    Raises
    ------
    SceneError
        The grid is too fine, or fewer than two positions are left.
    """
    sensors, length = scene.sensors, scene.beam.length_mm
    if length / sensors.grid_mm > MAX_SENSOR_POSITIONS:
        raise SceneError(
            f"sensors.grid_mm = {sensors.grid_mm:g} makes more than {MAX_SENSOR_POSITIONS} positions; make it coarser"
        )
    fixed_mm = np.unique(np.asarray(sensors.fixed_mm, dtype=np.float64))
    grid = np.minimum(np.arange(np.floor(length / sensors.grid_mm + ROUNDING) + 1) * sensors.grid_mm, length)
    for _, start, end in taken_mm(scene.beam, sensors):
        grid = grid[(grid <= start) | (grid >= end)]
    # A fixed sensor keeps the digits of the scene.
    apart = np.abs(grid[:, None] - fixed_mm).min(axis=1, initial=np.inf) > ROUNDING * length
    position = np.union1d(grid[apart], fixed_mm)
    if len(position) < 2:
        raise SceneError(
            "sensors: grid_mm, size_mm and keep_out_mm leave fewer than two positions; keep out less, refine the grid, "
            "or correct size_mm"
        )
    return position


@dataclass(frozen=True)
class Travel:
    """How far the contacts of a scene move its beam, anywhere on it."""

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

    def check_small_angles(self, room_mm: float = math.inf) -> None:
        """Raise SceneError if the deflection is beyond small-angle theory.

        Parameters
        ----------
        room_mm : travel that the sensors allow; the force and the stiffness that the error names keep to it as well
        """
        if not self.slope <= MAX_SLOPE:
            travel_mm = self.lift_mm + self.fall_mm
            excess = max(self.slope / MAX_SLOPE, travel_mm / room_mm)
            also = f", and travels {digits(travel_mm, 4)} mm, beyond sensors.range_mm" if travel_mm > room_mm else ""
            raise SceneError(
                f"at {self.force_n:g} N the beam slopes by {digits(self.slope, 3)} rad, beyond the {MAX_SLOPE:g} rad "
                f"of small-angle theory{also}; end contact.force_n at {at_most(self.force_n / excess):g} N, "
                f"or make the beam {at_least(excess):g} times as stiff"
            )


def travel_of(scene: Scene) -> Travel:
    """Return the travel of a scene's beam; SceneError if it is beyond what can be computed."""
    points, force_n = np.linspace(0.0, scene.beam.length_mm, POINTS), scene.contact.force_range_n[1]
    with np.errstate(over="ignore"):
        shapes = influence_matrix(scene, points, load_positions_mm(scene)) * force_n
    if not np.all(np.isfinite(shapes)):
        message = "the deflection at the largest force is beyond what can be computed; check contact.force_n and beam"
        raise SceneError(message)
    slope = float(np.abs(np.diff(shapes, axis=1)).max() / (points[1] - points[0]))
    return Travel(max(0.0, -float(shapes.min())), max(0.0, float(shapes.max())), slope, force_n)
