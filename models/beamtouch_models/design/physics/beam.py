"""The influence matrix: deflection at each sensor per newton, for each load position."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from beamtouch_common.digits import digits
from beamtouch_models.arrays import Floats
from beamtouch_models.design.physics.closed_forms import patch_influence, point_influence, span_of
from beamtouch_models.design.physics.influence_function import InfluenceFunction, Travel, even_loads_mm
from beamtouch_models.design.physics.mesh import element_influence
from beamtouch_models.design.scene import Scene
from beamtouch_models.design.scene.beam import SMALLEST_NORMAL, Beam
from beamtouch_models.design.scene.plausible import ROUNDING, taken_mm
from beamtouch_models.design.scene.tables import Sensors
from beamtouch_models.errors import SceneError, require
from beamtouch_models.numbers import at_least, at_most, places_in

MAX_SENSOR_POSITIONS = 20_000
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
    """Return the load positions of the influence matrix of a scene's beam."""
    return even_loads_mm(scene.contact.ranges_mm, scene.size_mm)


def sensor_positions_mm(sensors: Sensors, length: float, held_mm: Sequence[float]) -> Floats:
    """Return the positions that a sensor may take, ascending: those of the grid with room for a housing, and the fixed.

    The structure is `length` mm long, and held at `held_mm`.

    Raises
    ------
    SceneError
        The grid is too fine, a fixed sensor is off the structure, or fewer than two positions are left.
    """
    if length / sensors.grid_mm > MAX_SENSOR_POSITIONS:
        raise SceneError(
            f"sensors.grid_mm = {sensors.grid_mm:g} makes more than {MAX_SENSOR_POSITIONS} positions; make it coarser"
        )
    fixed_mm = np.unique(places_in(sensors.fixed_mm, "sensors.fixed_mm", length)) if sensors.fixed_mm else np.array([])
    grid = np.minimum(np.arange(np.floor(length / sensors.grid_mm + ROUNDING) + 1) * sensors.grid_mm, length)
    for _, start, end in taken_mm(length, held_mm, sensors):
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


def check_small_angles(travel: Travel, room_mm: float = math.inf) -> None:
    """Raise SceneError if a beam's travel is beyond small-angle theory.

    Parameters
    ----------
    travel : of the beam
    room_mm : travel that the sensors allow; the force and the stiffness that the error names keep to it as well
    """
    if travel.slope > MAX_SLOPE:
        travel_mm = travel.lift_mm + travel.fall_mm
        excess = max(travel.slope / MAX_SLOPE, travel_mm / room_mm)
        also = f", and travels {digits(travel_mm, 4)} mm, beyond sensors.range_mm" if travel_mm > room_mm else ""
        raise SceneError(
            f"at {travel.force_n:g} N the beam slopes by {digits(travel.slope, 3)} rad, beyond the {MAX_SLOPE:g} rad "
            f"of small-angle theory{also}; end contact.force_n at {at_most(travel.force_n / excess):g} N, "
            f"or make the beam {at_least(excess):g} times as stiff"
        )
