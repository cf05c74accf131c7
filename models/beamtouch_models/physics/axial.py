"""Axial force in a beam that is held lengthwise while its temperature changes, and its effect on the deflection.

A beam held at two places cannot lengthen between them. A change of temperature T leaves it with the axial force

    N = alpha T L / sum of h / (E A)

over its sections of length h, compression positive (Gere & Goodno, Mechanics of Materials, sec. 2.5). For a rectangular
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
from beamtouch_models.structure import Beam

LONGEST = 1 / 256
"""Longest element, in units of the beam's length."""
HALVINGS = 40
"""Steps of the search for the critical force, to a relative 1e-12."""
MOST = 2.0**60
"""Largest axial force in units of E I / l^2; no beam buckles that late."""


@dataclass(frozen=True)
class Held:
    """A beam held lengthwise between two of its supports."""

    start_mm: float
    end_mm: float
    force_n_per_k: float
    """Compression per kelvin of warming."""
    critical_n: float
    """Compression at which it buckles."""

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
    stretch, expansion_per_k = held_stretch_mm(beam), beam.expansion_per_k
    if stretch is None or expansion_per_k is None:
        return None
    compliance = np.float64(0.0)
    ends = [0.0, *(section.to_mm for section in beam.sections)]
    for (start, end), section in zip(pairwise(ends), beam.sections, strict=True):
        if section.thickness_mm is None:
            return None
        with np.errstate(all="ignore"):
            per_mm = np.square(np.float64(section.thickness_mm)) / (12 * section.rigidity_n_mm2)
            compliance += max(0.0, min(end, stretch[1]) - max(start, stretch[0])) * per_mm
    with np.errstate(all="ignore"):
        per_k = float(expansion_per_k * (stretch[1] - stretch[0]) / compliance)
        critical_n = float(_critical(beam) * beam.rigidity_n_mm2 / np.square(np.float64(beam.length_mm)))
    if not (0 < per_k < np.inf and 0 < critical_n < np.inf):
        message = "beam: its axial force cannot be computed; check length, thickness and expansion_um_per_m_k"
        raise SceneError(message)
    return Held(*stretch, per_k, critical_n)


def influence_change(beam: Beam, force_n: float, sensor_mm: Floats, low_mm: Floats, high_mm: Floats) -> Floats | None:
    """Return how an axial force changes the influence of contacts from `low_mm` to `high_mm`.

    The result is (loads, sensors) in mm/N; None if the beam buckles. Compression is positive.
    """
    mesh = mesh_of(beam, LONGEST)
    factor = _factor(mesh, beam, force_n * beam.length_mm / beam.rigidity_n_mm2 * beam.length_mm)
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
    mesh = mesh_of(beam, LONGEST)
    high = 1.0
    while high < MOST and _factor(mesh, beam, high) is not None:
        high *= 2
    low = high / 2 if high > 1 else 0.0
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        low, high = (middle, high) if _factor(mesh, beam, middle) is not None else (low, middle)
    return low


def _factor(mesh: Mesh, beam: Beam, axial: float) -> Floats | None:
    """Return the banded factor of K - N G for an axial force in units of E I / l^2; None if the beam buckles."""
    stretch = held_stretch_mm(beam)
    if stretch is None or not np.isfinite(axial):
        return None
    middle = (mesh.node_mm[:-1] + mesh.node_mm[1:]) / 2
    tension = np.where((stretch[0] < middle) & (middle < stretch[1]), axial / mesh.elements.height, 0.0)
    matrices = mesh.stiffness.copy()
    for row, column, sign in ((0, 0, -1), (2, 2, -1), (0, 2, 1), (2, 0, 1)):
        matrices[:, row, column] += sign * tension
    try:
        factor: Floats = cholesky_banded(banded(matrices, mesh.springs, mesh.held), lower=True)
    except LinAlgError:
        return None
    return factor
