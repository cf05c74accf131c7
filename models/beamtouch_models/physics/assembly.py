"""Influence matrix of a structure of beam elements, for point loads and for contacts with a width."""

import numpy as np

from beamtouch_models.arrays import Floats, Indices
from beamtouch_models.physics.elements import clamped, gauss_rule, shapes
from beamtouch_models.physics.mesh import Mesh, mesh_of, solve
from beamtouch_models.scene.beam import Beam


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
    for at, weight in _rule(mesh, low_mm, high_mm):
        from_left = ((start - left) * (1 - at) + (end - left) * at) / length
        from_right = ((right - start) * (1 - at) + (right - end) * at) / length
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
            for at, weight in rule:
                load = first * (1 - at) + final * at
                near = (np.minimum(x, load) - left) / mesh.length_mm
                far = (right - np.maximum(x, load)) / mesh.length_mm
                matrix[np.ix_(rows, columns)] += weight * share * clamped(near, far, of)
