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

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from beamtouch_models.arrays import Floats
from beamtouch_models.design.physics.beam import influence
from beamtouch_models.design.scene.beam import Beam
from beamtouch_models.errors import SceneError

SEGMENTS = 256
"""Smallest number of sides of the polygon."""


class Held(NamedTuple):
    """The axial force that temperature causes in a beam that is held lengthwise."""

    force_n_per_k: float
    """Compression per kelvin of warming, where it is largest."""
    buckles_k: float
    """Warming at which it buckles."""

    def change(self, warming_k: float) -> float:
        """Return the relative change of the largest deflection, for a warming below that at which it buckles.

        It is that of a deflection in the shape in which the beam buckles, 1 / (1 - N / critical) - 1, and that of a
        load in the middle within a few percent of the deflection (Timoshenko & Gere, sec. 1.11).
        """
        return warming_k / (self.buckles_k - warming_k)


def holding_mm(beam: Beam) -> list[float]:
    """Return the places of the supports that hold a beam lengthwise, from left to right."""
    return [support.at_mm for support in beam.support_list if support.holds_lengthwise]


def held(beam: Beam) -> Held | None:
    """Return what temperature does to a beam; None if it may lengthen, or expansion or thickness are not stated.

    Raises
    ------
    SceneError
        The beam is beyond what can be computed.
    """
    forces = _forces_n_per_k(beam)
    if forces is None:
        return None
    most, buckles_k = forces.max(), 0.0
    if np.all((forces > 0) & (forces < np.inf)):
        with np.errstate(all="ignore"):
            buckles_k = float(1 / _softest_per_n(beam, forces / most) / most)
    if not 0 < buckles_k < np.inf:
        raise SceneError("beam: its axial force cannot be computed; check length, thickness and expansion_um_per_m_k")
    return Held(float(most), buckles_k)


def _forces_n_per_k(beam: Beam) -> Floats | None:
    """Return the compression per kelvin of each stretch between two supports that hold the beam, (stretches,)."""
    if beam.expansion_per_k is None or len(holding_mm(beam)) < 2:
        return None
    forces_n_per_k, ends = [], [0.0, *(section.to_mm for section in beam.sections)]
    with np.errstate(all="ignore"):
        for low, high in pairwise(holding_mm(beam)):
            compliance = np.float64(0.0)
            for (start, end), section in zip(pairwise(ends), beam.sections, strict=True):
                inside_mm = max(0.0, min(end, high) - max(start, low))
                if not inside_mm:
                    continue
                if section.thickness_mm is None:
                    return None
                per_mm = np.square(np.float64(section.thickness_mm)) / (12 * section.rigidity_n_mm2)
                compliance += inside_mm * per_mm
            forces_n_per_k.append(beam.expansion_per_k * (high - low) / compliance)
    return np.array(forces_n_per_k)


def _softest_per_n(beam: Beam, share: Floats) -> float:
    """Return the largest eigenvalue of B G B', in 1/N.

    `share` (stretches,) is the tension of each stretch over that where it is largest; beyond them there is none.
    """
    holding = holding_mm(beam)
    steps, supports = [section.to_mm for section in beam.sections], beam.held_mm
    node_mm = np.unique(np.concatenate([np.linspace(0.0, beam.length_mm, SEGMENTS + 1), steps, supports]))
    stretch = np.searchsorted(holding, (node_mm[:-1] + node_mm[1:]) / 2)
    tension = np.concatenate([[0.0], share, [0.0]])[stretch]
    slopes = np.diff(np.eye(len(node_mm)), axis=0) * np.sqrt(tension / np.diff(node_mm))[:, None]
    bent = slopes @ influence(beam, node_mm, node_mm) @ slopes.T
    return float(np.linalg.eigvalsh((bent + bent.T) / 2)[-1])
