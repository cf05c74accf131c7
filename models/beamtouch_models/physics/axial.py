"""Axial force in a beam that is held lengthwise while its temperature changes, and its effect on the deflection.

A beam held at two places cannot lengthen between them. A change of temperature T leaves it with the axial force

    N = alpha T L / sum of h / (E A)

over its sections of length h, compression positive (Gere & Goodno, Mechanics of Materials, sec. 2.5). If more supports
hold it, each stretch between two of them has its own force. For a rectangular
section of thickness t, E A = 12 E I / t^2. Compression softens the beam against bending, tension stiffens it: with the
stiffness K of the beam and the stiffness G of a string under unit tension, nodal forces f deflect it by

    w = (K - N G)^-1 f

(Timoshenko & Gere, Theory of Elastic Stability, 2nd ed. 1961, ch. 1). It buckles where K - N G is no longer positive
definite. The elements are short, so that the string's polygon follows the beam within 1e-4.
"""

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import numpy as np
from scipy.linalg import LinAlgError, cho_solve_banded, cholesky_banded

from beamtouch_models.arrays import Floats
from beamtouch_models.errors import SceneError
from beamtouch_models.physics.assembly import nodal_loads
from beamtouch_models.physics.mesh import Mesh, banded, mesh_of
from beamtouch_models.scene.beam import Beam

MAX_ELEMENT = 1 / 256
"""Longest element, in units of the beam's length."""
HALVINGS = 40
"""Steps of the search for the critical force, to a relative 1e-12."""
MAX_FORCE = 2.0**60
"""Largest axial force in units of E I / l^2; no beam buckles that late."""


@dataclass(frozen=True)
class Held:
    """A beam held lengthwise between two of its supports."""

    start_mm: float
    end_mm: float
    force_n_per_k: float
    """Compression per kelvin of warming, where it is largest."""
    critical_n: float
    """That compression when the beam buckles."""

    @property
    def buckles_k(self) -> float:
        """Warming at which it buckles."""
        return self.critical_n / self.force_n_per_k


def held_stretch_mm(beam: Beam) -> tuple[float, float] | None:
    """Return the ends of the stretch that cannot lengthen; None if at most one support holds the beam lengthwise."""
    places = [support.at_mm for support in beam.support_list if support.holds_lengthwise]
    return (places[0], places[-1]) if len(places) > 1 else None


def held(beam: Beam) -> Held | None:
    """Return what temperature does to a beam; None if it may lengthen, or expansion or thickness are not stated.

    Raises
    ------
    SceneError
        The beam is beyond what can be computed.
    """
    stretch, forces = held_stretch_mm(beam), _forces_n_per_k(beam)
    if stretch is None or forces is None:
        return None
    critical_n = 0.0
    if all(0 < force < np.inf for _, _, force in forces):
        with np.errstate(all="ignore"):
            critical_n = float(_critical(beam) * beam.rigidity_n_mm2 / np.square(np.float64(beam.length_mm)))
    if not 0 < critical_n < np.inf:
        message = "beam: its axial force cannot be computed; check length, thickness and expansion_um_per_m_k"
        raise SceneError(message)
    return Held(*stretch, max(force for _, _, force in forces), critical_n)


def _forces_n_per_k(beam: Beam) -> list[tuple[float, float, float]] | None:
    """Return start, end and compression per kelvin of each stretch between two supports that hold the beam.

    None if expansion or thickness are not stated.
    """
    expansion_per_k, found = beam.expansion_per_k, []
    if expansion_per_k is None:
        return None
    holding = [support.at_mm for support in beam.support_list if support.holds_lengthwise]
    ends = [0.0, *(section.to_mm for section in beam.sections)]
    for low, high in pairwise(holding):
        compliance = np.float64(0.0)
        for (start, end), section in zip(pairwise(ends), beam.sections, strict=True):
            inside_mm = max(0.0, min(end, high) - max(start, low))
            if inside_mm and section.thickness_mm is None:
                return None
            with np.errstate(all="ignore"):
                per_mm = np.square(np.float64(section.thickness_mm or 0.0)) / (12 * section.rigidity_n_mm2)
                compliance += inside_mm * per_mm
        with np.errstate(all="ignore"):
            found.append((low, high, float(expansion_per_k * (high - low) / compliance)))
    return found


def influence_change(beam: Beam, force_n: float, sensor_mm: Floats, low_mm: Floats, high_mm: Floats) -> Floats | None:
    """Return how an axial force changes the influence of contacts from `low_mm` to `high_mm`.

    `force_n` is the force of the stretch where it is largest; compression is positive. The result is (loads, sensors)
    in mm/N; None if the beam buckles.
    """
    mesh = mesh_of(beam, MAX_ELEMENT)
    factor = _factor(mesh, _share(mesh, beam), force_n * beam.length_mm / beam.rigidity_n_mm2 * beam.length_mm)
    if factor is None:
        return None
    loads, sensors = nodal_loads(mesh, low_mm, high_mm), nodal_loads(mesh, sensor_mm, sensor_mm)
    loads[:, mesh.held] = 0.0
    moved = cho_solve_banded((factor, True), loads.T) - cho_solve_banded((mesh.factor, True), loads.T)
    change: Floats = moved.T @ sensors.T * (beam.length_mm * beam.length_mm / beam.rigidity_n_mm2 * beam.length_mm)
    return change


@lru_cache(maxsize=16)
def _critical(beam: Beam) -> float:
    """Return the critical compression in units of E I / l^2."""
    mesh = mesh_of(beam, MAX_ELEMENT)
    share, high = _share(mesh, beam), 1.0
    while high < MAX_FORCE and _factor(mesh, share, high) is not None:
        high *= 2
    low = high / 2 if high > 1 else 0.0
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        low, high = (middle, high) if _factor(mesh, share, middle) is not None else (low, middle)
    return low


def _share(mesh: Mesh, beam: Beam) -> Floats:
    """Return the force in each element (elements,) over that where it is largest; 0 beyond the supports that hold."""
    middle = (mesh.node_mm[:-1] + mesh.node_mm[1:]) / 2
    share, forces = np.zeros(len(middle)), _forces_n_per_k(beam) or []
    for start, end, force in forces:
        share[(start < middle) & (middle < end)] = force / max(one for _, _, one in forces)
    return share


def _factor(mesh: Mesh, share: Floats, axial: float) -> Floats | None:
    """Return the banded factor of K - N G for an axial force in units of E I / l^2; None if the beam buckles."""
    if not np.isfinite(axial):
        return None
    tension = share * axial / mesh.elements.height
    matrices = mesh.stiffness.copy()
    for row, column, sign in ((0, 0, -1), (2, 2, -1), (0, 2, 1), (2, 0, 1)):
        matrices[:, row, column] += sign * tension
    try:
        factor: Floats = cholesky_banded(banded(matrices, mesh.springs, mesh.held), lower=True)
    except LinAlgError:
        return None
    return factor
