"""Axial force in a beam that is held lengthwise while its temperature changes, and the warming at which it buckles.

A beam held at two places cannot lengthen between them. A change of temperature T leaves it with the axial force

    N = alpha T L / sum of h / (E A)

over its sections of length h, compression positive (Gere & Goodno, Mechanics of Materials, sec. 2.5). If more supports
hold it, each stretch between two of them has its own force. For a rectangular section of thickness t, E A = 12 E I /
t^2. Compression softens the beam against bending, tension stiffens it (Timoshenko & Gere, Theory of Elastic Stability,
2nd ed. 1961, ch. 1). With the flexibility G of the beam and the stiffness B'B of a string under unit tension, it
buckles where N reaches one over the largest eigenvalue of B G B'. G is the influence matrix, so this holds for any
beam. The string is a polygon, so short that it follows the beam within 1e-4.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from beamtouch_models.errors import SceneError
from beamtouch_models.physics.beam import influence
from beamtouch_models.scene.beam import Beam

SEGMENTS = 256
"""Smallest number of sides of the polygon."""


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

    def change(self, warming_k: float) -> float:
        """Return the relative change of the largest deflection, for a warming below that at which it buckles.

        It is that of a deflection in the shape in which the beam buckles, 1 / (1 - N / critical) - 1, and that of a
        load in the middle within a few percent of the deflection (Timoshenko & Gere, sec. 1.11).
        """
        return warming_k / (self.buckles_k - warming_k)


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
            critical_n = 1 / _softest_per_n(beam, forces)
    if not 0 < critical_n < np.inf:
        raise SceneError("beam: its axial force cannot be computed; check length, thickness and expansion_um_per_m_k")
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


def _softest_per_n(beam: Beam, forces: list[tuple[float, float, float]]) -> float:
    """Return the largest eigenvalue of B G B', in 1/N.

    The tension in each side of the string is over that where it is largest, and 0 beyond the supports that hold.
    """
    steps = [section.to_mm for section in beam.sections]
    supports = [support.at_mm for support in beam.support_list]
    node_mm = np.unique(np.concatenate([np.linspace(0.0, beam.length_mm, SEGMENTS + 1), steps, supports]))
    middle_mm = (node_mm[:-1] + node_mm[1:]) / 2
    share = np.zeros(len(middle_mm))
    for start, end, force in forces:
        share[(start < middle_mm) & (middle_mm < end)] = force / max(one for _, _, one in forces)
    slopes = np.diff(np.eye(len(node_mm)), axis=0) * np.sqrt(share / np.diff(node_mm))[:, None]
    bent = slopes @ influence(beam, node_mm, node_mm) @ slopes.T
    return float(np.linalg.eigvalsh((bent + bent.T) / 2)[-1])
