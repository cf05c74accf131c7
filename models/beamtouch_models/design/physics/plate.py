"""The influence of a thin plate: the deflection at places per newton at others. Where sensors may stand.

Kirchhoff's plate in rectangular elements of Bogner, Fox & Schmit (`hermite`), whose stiffness is a sum of Kronecker
products of matrices of one axis. Lengths count in the longer side l, deflections in l^2/D. The free plate is held at
three corners and factored once. The supports, rigid or on springs, are forces on it that are found with the three
motions of a rigid body: so springs may be as soft or as stiff as they like, without a loss of digits, and stand
anywhere. By reciprocity, a load takes the place of a sensor where there are fewer of them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache, partial

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike
from scipy.linalg import lu_factor, lu_solve
from scipy.sparse.linalg import SuperLU, splu

from beamtouch_models.arrays import Floats, Indices
from beamtouch_models.design.physics.hermite import HermiteAxis
from beamtouch_models.design.physics.influence_function import InfluenceFunction, even_loads_mm
from beamtouch_models.design.scene import Scene
from beamtouch_models.design.scene.beam import SMALLEST_NORMAL
from beamtouch_models.design.scene.plate import Plate, PlateSupport
from beamtouch_models.design.scene.plausible import ROUNDING
from beamtouch_models.design.scene.plausible_plate import taken_on_plate, xy_of
from beamtouch_models.design.scene.tables import Sensors
from beamtouch_models.errors import SceneError
from beamtouch_models.numbers import array_of
from beamtouch_models.places import grid_of

ELEMENTS = 768
"""Elements of a plate, about: 32 by 24 of one of 4 by 3. Deflections are then within 0.03 % of the largest."""
FEWEST = 6
"""Elements along the shorter side, at least."""
RIGID = 1e-12
"""Flexibility of a rigid support, over that of the plate: two rigid supports at one place share the load."""
GRID, ACROSS, CANDIDATES = 40, 8, 2000
"""Steps of the grid of sensors along the longer side, and at least along the shorter one if that does not make more
than so many places, unless the scene states a grid."""
MAX_SENSOR_PLACES = 10_000
KEPT = 16_000_000
"""Largest number of unknowns that are kept of a plate's deflections: 128 MB. `explain` asks for those under all loads
four times, a placement for those of all candidates under ever other loads, a fit for few with ever other springs."""
FEWER = 8
"""Sensors over loads from which on the influence comes from the loads by reciprocity."""
AT_ONCE = 16
"""Loads that are solved for at once: their unknowns stay in the processor's cache, which takes 0.6 of the time."""


@dataclass(frozen=True, eq=False)
class FreePlate:
    """A plate of one shape without supports, held at three corners; lengths in its longer side, D = 1."""

    x: HermiteAxis
    y: HermiteAxis
    free: Indices
    """The unknowns that are not held."""
    factors: SuperLU
    rigid: Floats
    """(unknowns, 3) motions of a rigid body: 1, x, y."""
    kept: dict[tuple[bytes, bytes], Floats]
    """Deflections under loads that were asked for lately, the latest last."""

    def row(self, place: Floats, order: tuple[int, int] = (0, 0)) -> sp.csr_matrix:
        """Return the weights (places, unknowns) of the unknowns in a derivative at places (places, 2)."""
        return self._products(self.x.at(place[:, 0], order[0]), self.y.at(place[:, 1], order[1]))

    def mean_row(self, low: Floats, high: Floats) -> sp.csr_matrix:
        """Return the weights (places, unknowns) in the mean over rectangles with these corners, (places, 2) each."""
        return self._products(self.x.over(low[:, 0], high[:, 0]), self.y.over(low[:, 1], high[:, 1]))

    def _products(self, along_x: tuple[Indices, Floats], along_y: tuple[Indices, Floats]) -> sp.csr_matrix:
        index = along_x[0][:, :, None] * self.y.unknowns + along_y[0][:, None]
        weight = along_x[1][:, :, None] * along_y[1][:, None]
        places, each = len(index), math.prod(index.shape[1:])
        shape = (places, self.x.unknowns * self.y.unknowns)
        return sp.csr_matrix((weight.ravel(), index.ravel(), each * np.arange(places + 1)), shape=shape)

    def deflections(self, loads: sp.csr_matrix) -> Floats:
        """Return the unknowns (unknowns, loads) of the plate held at three corners under loads (loads, unknowns)."""
        asked = loads.indices.tobytes(), loads.data.tobytes()
        if (deflections := self.kept.pop(asked, None)) is None:
            deflections = self._solve(loads)
        if deflections.size <= KEPT:
            self.kept[asked] = deflections
        while sum(known.size for known in self.kept.values()) > KEPT:
            del self.kept[next(iter(self.kept))]
        return deflections

    def _solve(self, loads: sp.csr_matrix) -> Floats:
        deflections, forces = np.zeros((loads.shape[1], loads.shape[0])), loads[:, self.free]
        for first in range(0, loads.shape[0], AT_ONCE):
            some = slice(first, first + AT_ONCE)
            deflections[self.free, some] = self.factors.solve(np.asfortranarray(forces[some].T.toarray()))
        return deflections


@lru_cache(maxsize=4)  # on other springs, or thicker, a plate is the same
def free_plate(length_x: float, length_y: float, poisson: float) -> FreePlate:
    """Return a free plate of these lengths, of which the longer one is 1."""
    across = math.sqrt(ELEMENTS / (length_x * length_y))
    most = ELEMENTS // FEWEST
    x, y = (HermiteAxis(length, min(most, max(FEWEST, round(length * across)))) for length in (length_x, length_y))
    mass, slope, bend, cross = (
        [axis.products(*orders) for axis in (x, y)] for orders in ((0, 0), (1, 1), (2, 2), (2, 0))
    )
    stiffness = (
        sp.kron(bend[0], mass[1])
        + sp.kron(mass[0], bend[1])
        + poisson * (sp.kron(cross[0], cross[1].T) + sp.kron(cross[0].T, cross[1]))
        + 2 * (1 - poisson) * sp.kron(slope[0], slope[1])
    ).tocsc()
    corners = [0, y.unknowns - 2, (x.unknowns - 2) * y.unknowns]
    free = np.setdiff1d(np.arange(stiffness.shape[0]), corners)
    factors = splu(
        stiffness[free][:, free], permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
    )
    ones = x.constant(), y.constant()
    rigid = [np.kron(*ones), np.kron(x.rising(), ones[1]), np.kron(ones[0], y.rising())]
    return FreePlate(x, y, free, factors, np.stack(rigid, axis=1), {})


@dataclass(frozen=True, eq=False)
class SupportedPlate:
    """A plate on its supports."""

    plate: Plate
    unit_mm: float
    """The longer side."""
    unit_mm_per_n: float
    """l^2/D."""
    body: FreePlate
    at_supports: sp.csr_matrix
    """(points, unknowns) weights in the deflection at the points of the supports."""
    pushed: Floats
    """(unknowns, points) of the free plate, held at three corners, under a force at each point."""
    system: tuple[Floats, Indices]
    """Factors of the equations for the forces of the supports and the motion of the rigid body."""
    flexibility: Floats
    """(points,) of the springs."""

    def influence(self, sensor_mm: Floats, load_mm: Floats, width_mm: float = 0.0) -> Floats:
        """Return the deflection (loads, sensors) in mm/N; arguments as `influence`."""
        sensors, loads = self._rows(sensor_mm, 0.0), self._rows(load_mm, width_mm)
        if len(sensor_mm) > CANDIDATES or len(sensor_mm) > FEWER * len(load_mm):
            matrix = self._under(loads, sensors).T
        else:
            matrix = self._under(sensors, loads)
        result: Floats = self.unit_mm_per_n * matrix
        return result

    def slopes(self, at_mm: Floats, load_mm: Floats, width_mm: float = 0.0) -> Floats:
        """Return the slopes (loads, places, axes) at places (places, 2), in 1/N."""
        loads = self._rows(load_mm, width_mm)
        rows = [self.body.row(at_mm / self.unit_mm, order) for order in ((1, 0), (0, 1))]
        slopes: Floats = np.stack([self._under(loads, row).T for row in rows], axis=2)
        return slopes * (self.unit_mm_per_n / self.unit_mm)

    def curvatures(self, at_mm: Floats, load_mm: Floats, width_mm: float = 0.0) -> Floats:
        """Return the sum of the curvatures along both axes (loads, places) at places (places, 2), in 1/(N mm)."""
        both = self.body.row(at_mm / self.unit_mm, (2, 0)) + self.body.row(at_mm / self.unit_mm, (0, 2))
        curvatures: Floats = self._under(self._rows(load_mm, width_mm), both).T
        return curvatures * (self.unit_mm_per_n / self.unit_mm**2)

    def bends(self, at_mm: Floats, load_mm: Floats, width_mm: float = 0.0) -> Floats:
        """Return the deflection (loads, places) in mm/N beyond the plane that fits the supports best.

        Only this stretches the plate: that it sinks or tilts on its springs does not.
        """
        rows, (held, forces, motion) = self._rows(at_mm, 0.0), self._solve(self._rows(load_mm, width_mm))
        plane = np.linalg.lstsq(self._motions(self.at_supports).T, self.flexibility[:, None] * forces, rcond=None)[0]
        bent: Floats = self._seen(rows, held, forces, motion - plane).T
        return self.unit_mm_per_n * bent

    def bowed(self, at_mm: Floats) -> Floats:
        """Return the deflection (places,) in mm for a curvature of 1/mm that the plate would take without supports.

        It bulges against the direction of the load, as (x^2 + y^2) / 2, and the supports hold it.
        """
        x, y = self.body.x, self.body.y
        free = (np.kron(x.squared(), y.constant()) + np.kron(x.constant(), y.squared()))[:, None] / 2
        known = np.concatenate([self.at_supports @ free, np.zeros((3, 1))])
        solved = lu_solve(self.system, known, check_finite=False)
        field = free - self.pushed @ solved[:-3] + self.body.rigid @ solved[-3:]
        bowed: Floats = (self._rows(at_mm, 0.0) @ field)[:, 0] * self.unit_mm**2
        return bowed

    def _rows(self, place_mm: Floats, width_mm: float) -> sp.csr_matrix:
        if not width_mm:
            return self.body.row(place_mm / self.unit_mm)
        size = np.array(self.plate.size_mm)
        low, high = np.maximum(place_mm - width_mm / 2, 0.0), np.minimum(place_mm + width_mm / 2, size)
        return self.body.mean_row(low / self.unit_mm, high / self.unit_mm)

    def _motions(self, rows: sp.csr_matrix) -> Floats:
        motions: Floats = (rows @ self.body.rigid).T
        return motions

    def _under(self, loads: sp.csr_matrix, rows: sp.csr_matrix) -> Floats:
        """Return what rows (rows, unknowns) of weights make of the unknowns under loads of 1, (rows, loads)."""
        return self._seen(rows, *self._solve(loads))

    def _seen(self, rows: sp.csr_matrix, held: Floats, forces: Floats, motion: Floats) -> Floats:
        # Weighed before they are added: there are fewer rows than unknowns.
        seen: Floats = rows @ held - rows @ self.pushed @ forces + rows @ self.body.rigid @ motion
        return seen

    def _solve(self, loads: sp.csr_matrix) -> tuple[Floats, Floats, Floats]:
        """Return the unknowns (unknowns, loads) of the plate held at three corners, under loads of 1.

        With them, the forces (points, loads) of its supports and the motion (3, loads) of the rigid body.
        """
        held = self.body.deflections(loads)
        known = np.concatenate([self.at_supports @ held, self._motions(loads)])
        solved = lu_solve(self.system, known, check_finite=False)
        return held, solved[:-3], solved[-3:]


@lru_cache(maxsize=4)  # asked for influence, slopes and bends in turn
def supported_plate(plate: Plate) -> SupportedPlate:
    """Return a plate on its supports; SceneError if it cannot be computed."""
    unit_mm = max(plate.size_mm)
    length_x, length_y = (length / unit_mm for length in plate.size_mm)
    body = free_plate(length_x, length_y, plate.poisson)
    unit_mm_per_n = unit_mm * unit_mm / plate.rigidity_n_mm
    points = [_points(support, body, unit_mm) for support in plate.support_list]
    rows = body.row(np.concatenate([place for place, _ in points]))
    with np.errstate(over="ignore"):
        flexibility = np.concatenate([given / unit_mm_per_n for _, given in points])
    if not (SMALLEST_NORMAL <= unit_mm_per_n < math.inf and np.isfinite(flexibility).all()):
        raise SceneError(
            "plate: its deflection is beyond what can be computed; check its lengths, thickness and springs"
        )
    pushed = body.deflections(rows)
    between = rows @ pushed
    least = RIGID * float(np.abs(np.diag(between)).max(initial=1.0))
    motions = rows @ body.rigid
    system = np.block([[between + np.diag(np.maximum(flexibility, least)), -motions], [motions.T, np.zeros((3, 3))]])
    return SupportedPlate(plate, unit_mm, unit_mm_per_n, body, rows, pushed, lu_factor(system), flexibility)


def _points(support: PlateSupport, body: FreePlate, unit_mm: float) -> tuple[Floats, Floats]:
    """Return the places (points, 2) that stand for a support, over l, and the flexibility (points,) of each in mm/N.

    A line has two points in each element, those of Gauss's rule.
    """
    stiffness = math.inf if support.stiffness_n_per_mm is None else support.stiffness_n_per_mm
    if not support.is_line:
        return np.array([[support.x_mm, support.y_mm]], dtype=np.float64) / unit_mm, np.array([1 / stiffness])
    axis, fixed_mm = (body.y, support.x_mm) if support.y_mm is None else (body.x, support.y_mm)
    middles = axis.step * (np.arange(axis.elements) + 0.5)
    along = np.sort(np.concatenate([middles + side * axis.step / math.sqrt(12.0) for side in (-1, 1)]))
    across = np.full(len(along), np.float64(fixed_mm or 0.0) / unit_mm)
    places = np.column_stack([across, along] if support.y_mm is None else [along, across])
    return places, np.full(len(along), len(along) / stiffness)


def influence(plate: Plate, sensor_mm: ArrayLike, load_mm: ArrayLike, width_mm: float = 0.0) -> Floats:
    """Return the deflection at each sensor per newton, for each place of a load.

    Parameters
    ----------
    plate : the plate
    sensor_mm : (sensors, 2) places in mm from the lower left corner
    load_mm : (loads, 2) places in mm
    width_mm : side of the square over which a load presses evenly, 0 or more, centred at its place. If it reaches
        beyond the rim, the whole force is spread over the part that lies on the plate.

    Returns
    -------
    (loads, sensors) in mm/N, positive in the direction of the load.

    Raises
    ------
    SceneError
        A place is not finite or not on the plate, or the plate cannot be computed.
    """
    sensor, load = places_on(sensor_mm, "sensor_mm", plate), places_on(load_mm, "load_mm", plate)
    return supported_plate(plate).influence(sensor, load, width_mm)


def heated(plate: Plate, at_mm: Floats) -> Floats:
    """Return the deflection (places,) in mm at places (places, 2) of a plate that is 1 K warmer above than below.

    The difference of temperature falls evenly through the thickness t: the free plate takes the curvature alpha / t
    along both axes (Timoshenko & Woinowsky-Krieger, 1959, art. 14). SceneError if its expansion is not stated.
    """
    if plate.expansion_per_k is None:
        raise SceneError("plate: state material or expansion_um_per_m_k; it sets how far heat bows the plate")
    bowed: Floats = plate.expansion_per_k / plate.thickness_mm * supported_plate(plate).bowed(at_mm)
    return bowed


def influence_of(scene: Scene, plate: Plate) -> InfluenceFunction:
    """Return the influence function of a scene with this plate; its unit is l^2/D, with the longer side l."""
    width_mm = scene.contact.width_mm
    return InfluenceFunction(
        plate.size_mm,
        load_places_mm(scene, plate),
        scene.contact.force_range_n,
        partial(influence, plate, width_mm=width_mm),
        supported_plate(plate).unit_mm_per_n,
    )


def load_places_mm(scene: Scene, plate: Plate) -> Floats:
    """Return the load places (places, 2) of the influence matrix: an even grid of about square cells."""
    return even_loads_mm(scene.contact.ranges_mm, plate.size_mm)


def places_on(values: ArrayLike, name: str, plate: Plate) -> Floats:
    """Return places on a plate as an array (places, 2); SceneError if one is not on it."""
    places = array_of(values, name)
    if places.ndim != 2 or places.shape[1] != 2 or not len(places):
        raise SceneError(f"{name}: give places as a list of pairs, x and y in mm")
    wrong = places[~np.all((places >= 0) & (places <= np.array(plate.size_mm)), axis=1)]
    if len(wrong):
        x, y = plate.size_mm
        raise SceneError(f"{name}: {wrong[0, 0]:g}, {wrong[0, 1]:g} lies off the plate, 0..{x:g} by 0..{y:g} mm")
    return places


def places_of_sensors(plate: Plate, sensors: Sensors) -> tuple[Floats, Indices]:
    """Return the places (places, 2) that a sensor may take, ascending by x and then by y, and which the fixed ones are.

    The places are those of the grid with room for a housing, and those of fixed sensors. SceneError if the grid is too
    fine, or fewer than two places are left.
    """
    step_mm = sensors.stated_grid_mm or max(1.0, round(_usual_step_mm(plate)))
    if math.prod(length / step_mm for length in plate.size_mm) > MAX_SENSOR_PLACES:
        raise SceneError(
            f"sensors.grid_mm = {step_mm:g} makes more than {MAX_SENSOR_PLACES} places on the plate; make it coarser"
        )
    ticks: list[Floats] = [
        np.arange(math.floor(length / step_mm + ROUNDING) + 1) * np.float64(step_mm) for length in plate.size_mm
    ]
    grid = np.minimum(grid_of(ticks), plate.size_mm)
    is_allowed = [not taken_on_plate(plate, sensors, (x, y)) for x, y in grid.tolist()]
    fixed = np.array([xy_of(place) for place in sensors.fixed], dtype=np.float64).reshape(len(sensors.fixed), 2)
    apart = np.linalg.norm(grid[:, None] - fixed, axis=2).min(axis=1, initial=np.inf)
    places = np.unique(np.concatenate([grid[is_allowed & (apart > ROUNDING * max(plate.size_mm))], fixed]), axis=0)
    if len(places) < 2:
        raise SceneError(
            "sensors: grid_mm, size_mm and keep_out leave fewer than two places; keep out less, refine the grid, or "
            "correct size_mm"
        )
    return places, np.flatnonzero((places[:, None] == fixed).all(axis=2).any(axis=1))


def _usual_step_mm(plate: Plate) -> float:
    """Return the step of a grid that a scene leaves open: places on one line would tell nothing across it."""
    across_mm = max(min(plate.size_mm) / ACROSS, math.sqrt(math.prod(plate.size_mm) / CANDIDATES))
    return min(max(plate.size_mm) / GRID, across_mm)
