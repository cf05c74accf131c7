"""The largest bending stress in a beam under a force that presses anywhere in a range.

Bending alone leaves the stress E t |w''| / 2 at the surface of a section of thickness t (Gere & Goodno, Mechanics of
Materials, sec. 5.5). The curvature w'' is the second difference of the deflection. Shear, notches and holes are left
out.
"""

import numpy as np

from beamtouch_models.design.physics.beam import influence
from beamtouch_models.design.scene.beam import Beam

PLACES, LOADS = 401, 41
"""Places along the beam and places of the force. The largest moment is low by some 0.3 % of that of a simple beam."""


def largest_stress_mpa(beam: Beam, force_n: float, range_mm: tuple[float, float]) -> float | None:
    """Return the largest stress in MPa; None if the thickness of a section is not stated.

    Raises
    ------
    SceneError
        The beam cannot be computed.
    """
    surfaces = []
    for section in beam.sections:
        if section.area_mm2 is None or section.thickness_mm is None:
            return None
        surfaces.append(6 * section.rigidity_n_mm2 / (section.area_mm2 * section.thickness_mm))
    places, step_mm = np.linspace(0.0, beam.length_mm, PLACES, retstep=True)
    slender = beam.model_copy(update={"shear_modulus_gpa": None})
    deflection = influence(slender, places, np.linspace(*range_mm, LOADS))
    ends_mm = np.array([section.to_mm for section in beam.sections])
    section_at = np.minimum(np.searchsorted(ends_mm, places), len(ends_mm) - 1)
    curvature = np.diff(deflection, n=2, axis=1) / step_mm**2
    # A difference across a step in the section belongs to neither side.
    curvature[:, section_at[2:] != section_at[:-2]] = 0.0
    # The moment is linear up to an end, which clamps may load most.
    first, last = 2 * curvature[:, 0] - curvature[:, 1], 2 * curvature[:, -1] - curvature[:, -2]
    curvature = np.column_stack([first, curvature, last])
    return force_n * float(np.abs(curvature * np.array(surfaces)[section_at]).max())
