"""The influence matrix: deflection at each sensor per newton, for each load position."""

import math
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from beamtouch_common.digits import digits
from beamtouch_models.arrays import Floats
from beamtouch_models.errors import SceneError
from beamtouch_models.physics.assembly import element_influence
from beamtouch_models.physics.closed_forms import patch_influence, point_influence, span_of
from beamtouch_models.physics.influence import InfluenceFunction
from beamtouch_models.rounding import at_most
from beamtouch_models.scene import Scene
from beamtouch_models.scene.beam import SMALLEST_NORMAL, Beam
from beamtouch_models.scene.misplaced import ROUNDING, taken_mm

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
    width_mm : length over which a load presses evenly, centred at its position. If it reaches beyond an end of the
        beam, the whole force is spread over the part that lies on the beam.

    Returns
    -------
    (loads, sensors) in mm/N, positive in the direction of the load. Values below 1e-307 mm/N lose digits.

    Raises
    ------
    ValueError
        A position is not finite or not on the beam, or the width is negative or not finite.
    SceneError
        The beam cannot be computed: it exceeds the range of float64, or it is so uneven that the result is inaccurate.
    """
    sensor = _on_beam(beam, sensor_mm, "sensor_mm")
    load = _on_beam(beam, load_mm, "load_mm")
    if not 0 <= width_mm < math.inf:
        message = "width_mm must be finite and not negative"
        raise ValueError(message)
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
        message = "beam: its deflection is beyond what can be computed; check length and rigidity"
        raise SceneError(message)
    return matrix


def scene_influence(scene: Scene, sensor_mm: ArrayLike, load_mm: ArrayLike) -> Floats:
    """Return the influence matrix of a scene's contacts, (loads, sensors) in mm/N; arguments, errors as `influence`."""
    return influence(scene.beam, sensor_mm, load_mm, scene.contact.width_mm)


def influence_of(scene: Scene) -> InfluenceFunction:
    """Return the influence function of a scene, with EI of the stiffest section; SceneError beyond float64."""
    return InfluenceFunction(
        scene.beam.length_mm,
        load_positions_mm(scene),
        scene.contact.force_range_n,
        partial(scene_influence, scene),
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
        message = (
            f"beam: {length_mm:g} mm long with a rigidity of {rigidity_n_mm2:g} N mm^2, it deflects beyond what can be "
            "computed; check length_mm, width_mm, thickness_mm and the modulus"
        )
        raise SceneError(message)
    return unit


def _on_beam(beam: Beam, position_mm: ArrayLike, name: str) -> Floats:
    """Return positions as an array; ValueError unless all lie on the beam."""
    position = np.atleast_1d(np.asarray(position_mm, dtype=np.float64))
    if position.ndim != 1 or position.size == 0:
        message = f"{name} must be a non-empty list of positions"
        raise ValueError(message)
    if not np.all(np.isfinite(position)) or position.min() < 0 or position.max() > beam.length_mm:
        message = f"{name} must be finite and lie on the beam, 0..{beam.length_mm:g} mm"
        raise ValueError(message)
    return position


def load_positions_mm(scene: Scene) -> Floats:
    """Return the load positions for the components: every 1/400 of the length, as in the paper."""
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
        message = (
            f"sensors.grid_mm = {sensors.grid_mm:g} makes more than {MAX_SENSOR_POSITIONS} positions; make it coarser"
        )
        raise SceneError(message)
    fixed_mm = np.unique(np.asarray(sensors.fixed_mm, dtype=np.float64))
    grid = np.minimum(np.arange(np.floor(length / sensors.grid_mm + ROUNDING) + 1) * sensors.grid_mm, length)
    for _, start, end in taken_mm(scene.beam, sensors):
        grid = grid[(grid <= start) | (grid >= end)]
    # A fixed sensor keeps the digits of the scene.
    apart = np.abs(grid[:, None] - fixed_mm).min(axis=1, initial=np.inf) > ROUNDING * length
    position = np.union1d(grid[apart], fixed_mm)
    if len(position) < 2:
        message = (
            "sensors: grid_mm, size_mm and keep_out_mm leave fewer than two positions; keep out less, refine the grid, "
            "or correct size_mm"
        )
        raise SceneError(message)
    return position


def travel_mm(scene: Scene) -> tuple[float, float]:
    """Return how far any point of the beam moves against, and in, the direction of the largest force, in mm.

    Both are positive or zero. A beam on two supports never moves against the force; a beam with an overhang does.
    """
    shapes = _shapes_mm(scene)[1]
    return max(0.0, -float(shapes.min())), max(0.0, float(shapes.max()))


def max_deflection_mm(scene: Scene) -> float:
    """Return the largest deflection in the scene, anywhere on the beam, in either direction, in mm."""
    return max(travel_mm(scene))


def check_small_angles(scene: Scene) -> None:
    """Raise SceneError if the deflection of a scene is beyond small-angle theory."""
    points, shapes = _shapes_mm(scene)
    slope = float(np.abs(np.diff(shapes, axis=1)).max() / (points[1] - points[0]))
    largest_n = scene.contact.force_range_n[1]
    if not slope <= MAX_SLOPE:
        message = (
            f"at {largest_n:g} N the beam slopes by {digits(slope, 3)} rad, beyond the {MAX_SLOPE:g} rad of "
            f"small-angle theory; end contact.force_n at {at_most(largest_n * MAX_SLOPE / slope):g} N, or make the "
            "beam stiffer"
        )
        raise SceneError(message)


def _shapes_mm(scene: Scene) -> tuple[Floats, Floats]:
    """Return points along the beam, and their deflections under the largest force at each load position."""
    points = np.linspace(0.0, scene.beam.length_mm, 801)
    with np.errstate(over="ignore"):
        shapes = scene_influence(scene, points, load_positions_mm(scene)) * scene.contact.force_range_n[1]
    if not np.all(np.isfinite(shapes)):
        message = "the deflection at the largest force is beyond what can be computed; check contact.force_n and beam"
        raise SceneError(message)
    return points, shapes
