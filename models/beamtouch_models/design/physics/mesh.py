"""Influence matrix of a structure of beam elements: steps, several spans, overhangs, shear, an elastic foundation.

Nodes stand only at supports and steps and, on a foundation, close enough for the elements' series to converge. The
stiffness is banded and symmetric. It is assembled only for beams that no closed form covers. Loads and sensors need no
nodes.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.linalg import LinAlgError, cho_solve_banded, cholesky_banded

from beamtouch_models.arrays import Floats, Indices
from beamtouch_models.design.physics.elements import (
    MAX_ON_FOUNDATION,
    Elements,
    clamped,
    elements_of,
    gauss_rule,
    rigid_forces,
    shapes,
    stiffness,
)
from beamtouch_models.design.scene.beam import SHEAR_COEFFICIENT, Beam
from beamtouch_models.errors import SceneError

MIN_ELEMENT = 1e-9
"""Shortest element, in units of the beam's length; closer nodes cannot be distinguished."""
MAX_ELEMENTS = 20_000
MAX_CORRECTION = 1e-10
"""Relative change of the solution in the last refinement, above which the solution is inaccurate."""
UNEVEN = (
    "beam: its parts are so uneven, or it is held so loosely, that too few digits would be right; "
    "take out very short segments and spans, or add a support"
)


@dataclass(frozen=True)
class Mesh:
    """Elements from left to right, and the factor of their stiffness matrix."""

    length_mm: float
    node_mm: Floats
    """(elements + 1,)"""
    elements: Elements
    held: Indices
    """Degrees of freedom held by the supports; node i has the deflection 2 i and the rotation 2 i + 1."""
    rotational_springs: Floats
    """(nodes,) rotational stiffness of the support at each node."""
    stiffness: Floats
    """(elements, 4, 4)"""
    rigid: Floats
    """(elements, 4, 2), forces under rigid motions."""
    factor: Floats
    """(4, 2 nodes), banded Cholesky factor."""


@lru_cache(maxsize=16)
def mesh_of(beam: Beam) -> Mesh:
    """Return the factorised mesh of a beam.

    Raises
    ------
    SceneError
        Its parts are too close together or too uneven.
    """
    length, reference = beam.length_mm, beam.rigidity_n_mm2
    foundation = (beam.foundation_n_mm2 or 0.0) * length / reference * length * length * length
    node = _nodes(beam, foundation)
    ends = [section.to_mm for section in beam.sections]
    section = np.searchsorted(ends, (node[:-1] + node[1:]) / 2)
    rigidity = np.array([section.rigidity_n_mm2 / reference for section in beam.sections])
    elements = elements_of(np.diff(node) / length, rigidity[section], _shear_compliance(beam)[section], foundation)
    held = [
        2 * int(np.searchsorted(node, support.at_mm)) + degree
        for support in beam.support_list
        for degree in ((0, 1) if support.kind == "fixed" else (0,))
    ]
    matrices = stiffness(elements)
    if not np.all(np.isfinite(matrices)):
        raise SceneError(UNEVEN)
    rotational_springs = np.zeros(len(node))
    for support in beam.support_list:
        rotational_springs[np.searchsorted(node, support.at_mm)] = support.rotational_stiffness
    factor = _factor(matrices, rotational_springs, held)
    return Mesh(
        length, node, elements, np.array(held, np.intp), rotational_springs, matrices, rigid_forces(elements), factor
    )


def _nodes(beam: Beam, foundation: float) -> Floats:
    """Return the nodes: ends, steps and supports, and on a foundation nodes between that keep the elements short."""
    ends = [section.to_mm for section in beam.sections]
    node = np.unique([0.0, *ends, *(support.at_mm for support in beam.support_list)])
    gaps = np.diff(node)
    if gaps.min() < MIN_ELEMENT * beam.length_mm:
        near = int(gaps.argmin())
        message = f"supports or segments at {node[near]:g} and {node[near + 1]:g} mm are too close to be told apart"
        raise SceneError(message)
    if foundation == 0:
        return node
    softest = min(section.rigidity_n_mm2 for section in beam.sections) / beam.rigidity_n_mm2
    slip = float(_shear_compliance(beam).max())
    steepest = max((foundation / (4 * softest)) ** 0.25, (foundation * slip) ** 0.5)
    pieces = np.maximum(np.ceil(gaps / beam.length_mm * steepest / MAX_ON_FOUNDATION), 1)
    if not pieces.sum() <= MAX_ELEMENTS:
        raise SceneError(_too_stiff(beam))
    stretches = [
        np.linspace(start, end, int(count), endpoint=False)
        for start, end, count in zip(node[:-1], node[1:], pieces, strict=True)
    ]
    return np.concatenate([*stretches, node[-1:]])


def _too_stiff(beam: Beam) -> str:
    return f"beam.foundation_n_mm2 = {beam.foundation_n_mm2:g} is too stiff beside this beam; make it softer"


def _shear_compliance(beam: Beam) -> Floats:
    """Return EI/(k G A l^2) of each section, with EI of the stiffest; zeros if the scene states no shear modulus."""
    if beam.shear_modulus_gpa is None:
        return np.zeros(len(beam.sections))
    area_mm2 = np.array([section.area_mm2 for section in beam.sections], dtype=np.float64)
    with np.errstate(all="ignore"):
        rigidity = SHEAR_COEFFICIENT * 1e3 * beam.shear_modulus_gpa * area_mm2
        compliance: Floats = beam.rigidity_n_mm2 / beam.length_mm / beam.length_mm / rigidity
    if not np.all(np.isfinite(compliance)):
        raise SceneError("beam.shear_modulus_gpa: with this section the shear deflection cannot be computed")
    return compliance


def _factor(matrices: Floats, rotational_springs: Floats, held: list[int]) -> Floats:
    """Assemble the banded stiffness of all elements (elements, 4, 4), hold the supports, factorise; (4, 2 nodes)."""
    elements = len(matrices)
    band = np.zeros((4, 2 * (elements + 1)))
    for column in range(4):
        for row in range(column, 4):
            band[row - column, column : column + 2 * elements : 2] += matrices[:, row, column]
    band[0, 1::2] += rotational_springs
    for degree in held:
        for below in range(1, min(4, degree + 1)):
            band[below, degree - below] = 0.0
    band[1:, held] = 0.0
    band[0, held] = 1.0
    try:
        factor: Floats = cholesky_banded(band, lower=True)
    except LinAlgError:
        raise SceneError(UNEVEN) from None
    return factor


def solve(mesh: Mesh, right: Floats) -> Floats:
    """Return refined displacements (degrees, columns) under nodal loads; raises SceneError if they are inaccurate."""
    right = right.copy()
    right[mesh.held] = 0.0
    solution: Floats = cho_solve_banded((mesh.factor, True), right)
    for _ in range(3):
        residual = right - _forces(mesh, solution)
        residual[mesh.held] = 0.0
        correction = cho_solve_banded((mesh.factor, True), residual)
        solution = solution + correction
    # Numbers below the smallest normal one have few digits. A load that stands nearly on a support gives such numbers.
    rounding = MAX_CORRECTION * np.abs(solution).max() + np.finfo(np.float64).tiny
    if not np.abs(correction).max() <= rounding:
        raise SceneError(UNEVEN)
    return solution


def _forces(mesh: Mesh, displacement: Floats) -> Floats:
    """Return the nodal forces under displacements (degrees, columns).

    Each element's rigid motion is separated from its deformation, so that the large stiffness of a short element
    multiplies only its small deformation. This makes the refinement in `solve` effective.
    """
    w, phi = displacement[0::2], displacement[1::2]
    chord = (w[1:] - w[:-1]) / mesh.elements.height[:, None]
    forces = mesh.stiffness[:, :, [1, 3]] @ np.stack([phi[:-1] - chord, phi[1:] - chord], axis=1)
    forces += mesh.rigid @ np.stack([w[:-1], w[1:]], axis=1)
    total = np.zeros_like(displacement)
    total[0:-2:2] += forces[:, 0]
    total[1:-2:2] += forces[:, 1]
    total[2::2] += forces[:, 2]
    total[3::2] += forces[:, 3]
    total[1::2] += mesh.rotational_springs[:, None] * phi
    return total


def element_influence(beam: Beam, sensor_mm: Floats, low_mm: Floats, high_mm: Floats) -> Floats:
    """Return the influence of evenly pressing contacts from `low_mm` to `high_mm`, or of point loads if both are equal.

    The result has the shape (loads, sensors) and the unit l^3/(EI), with EI of the stiffest section.

    Raises
    ------
    SceneError
        The structure is so nearly unstable or so uneven that the result would be inaccurate.
    """
    mesh = mesh_of(beam)
    loads = _nodal_loads(mesh, low_mm, high_mm)
    sensors = _nodal_loads(mesh, sensor_mm, sensor_mm)
    few = len(loads) < len(sensors)  # the stiffness is symmetric, so solve for the smaller set
    matrix = solve(mesh, loads.T).T @ sensors.T if few else loads @ solve(mesh, sensors.T)
    _add_within_elements(mesh, matrix, sensor_mm, low_mm, high_mm)
    # Rounding leaves a trace of deflection at a support, where it must be exactly zero.
    matrix[:, np.isin(sensor_mm, beam.held_mm)] = 0.0
    matrix[(low_mm == high_mm) & np.isin(low_mm, beam.held_mm)] = 0.0
    return matrix


def _touched(mesh: Mesh, low_mm: Floats, high_mm: Floats) -> tuple[Indices, Indices]:
    """Return all pairs of a contact and an element that it presses on."""
    last = len(mesh.node_mm) - 2
    if np.array_equal(low_mm, high_mm):
        return np.arange(len(low_mm)), np.clip(np.searchsorted(mesh.node_mm, low_mm, "right") - 1, 0, last)
    first = np.clip(np.searchsorted(mesh.node_mm, low_mm, "right") - 1, 0, last)
    final = np.maximum(np.searchsorted(mesh.node_mm, high_mm, "left") - 1, first)
    count = final - first + 1
    contact = np.repeat(np.arange(len(low_mm)), count)
    return contact, np.arange(len(contact)) - np.repeat(np.cumsum(count) - count - first, count)


def _rule(mesh: Mesh, low_mm: Floats, high_mm: Floats) -> tuple[tuple[float, float], ...]:
    """Return nodes and weights on 0..1 that integrate a load along a piece of an element to rounding."""
    if np.array_equal(low_mm, high_mm):
        return ((0.0, 1.0),)
    return gauss_rule(6 if mesh.elements.foundation else 2)


def _share(start: Floats, end: Floats, width: Floats, pieces: int) -> Floats:
    """Return the share of a contact's force on one of its pieces; the pieces of a point load have equal shares."""
    share: Floats = np.where(width > 0, (end - start) / np.where(width > 0, width, 1.0), 1 / pieces)
    return share


def _nodal_loads(mesh: Mesh, low_mm: Floats, high_mm: Floats) -> Floats:
    """Return the nodal forces of unit contacts, (contacts, degrees); for points these are also the shape functions."""
    contact, element = _touched(mesh, low_mm, high_mm)
    left, right = mesh.node_mm[element], mesh.node_mm[element + 1]
    low, high = low_mm[contact], high_mm[contact]
    start, end = np.maximum(low, left), np.minimum(high, right)
    share, length, of = _share(start, end, high - low, 1), mesh.length_mm, mesh.elements.pick(element)
    total = np.zeros((len(low_mm), 2 * len(mesh.node_mm)))
    for fraction, weight in _rule(mesh, low_mm, high_mm):
        from_left = ((start - left) * (1 - fraction) + (end - left) * fraction) / length
        from_right = ((right - start) * (1 - fraction) + (right - end) * fraction) / length
        forces = (weight * share)[:, None] * shapes(from_left, from_right, of)
        np.add.at(total, (contact[:, None], 2 * element[:, None] + np.arange(4)), forces)
    return total


def _add_within_elements(mesh: Mesh, matrix: Floats, sensor_mm: Floats, low_mm: Floats, high_mm: Floats) -> None:
    """Add the deflection of each contact's own element between clamped ends."""
    contact, element = _touched(mesh, low_mm, high_mm)
    sensor, of_sensor = _touched(mesh, sensor_mm, sensor_mm)
    rule = _rule(mesh, low_mm, high_mm)
    for index in np.intersect1d(element, of_sensor):
        rows, columns = contact[element == index], sensor[of_sensor == index]
        low, high, x = low_mm[rows, None], high_mm[rows, None], sensor_mm[None, columns]
        left, right = mesh.node_mm[index], mesh.node_mm[index + 1]
        start, end = np.maximum(low, left), np.minimum(high, right)
        middle = np.clip(x, start, end)
        of = mesh.elements.pick(index)
        # The third derivative of the deflection jumps at the sensor, so integrate each side separately.
        pieces = [(start, end)] if len(rule) == 1 else [(start, middle), (middle, end)]
        for first, final in pieces:
            share = _share(first, final, high - low, len(pieces))
            for fraction, weight in rule:
                load = first * (1 - fraction) + final * fraction
                near = (np.minimum(x, load) - left) / mesh.length_mm
                far = (right - np.maximum(x, load)) / mesh.length_mm
                matrix[np.ix_(rows, columns)] += weight * share * clamped(near, far, of)
