"""The beam as the service's page draws it: supports, and the deflected shape under a contact."""

import numpy as np

from beamtouch_models.metadata import Drawn, DrawnSupport
from beamtouch_models.physics.beam import influence
from beamtouch_models.scene import Scene

POINTS, LOADS = 41, 33
"""Positions along the beam and of the contact; a page interpolates between them."""
DIGITS = 4
"""Significant digits of a deflection."""


def drawn_of(scene: Scene) -> Drawn:
    """Return the drawing of a scene's beam."""
    at = np.linspace(0.0, scene.beam.length_mm, POINTS)
    load = np.linspace(*scene.contact.position_mm, LOADS)
    shape = influence(scene.beam, at, load, scene.contact.width_mm)
    return Drawn(
        supports=[
            DrawnSupport(at_mm=one.at_mm, kind=one.kind, slides=not one.holds_lengthwise)
            for one in scene.beam.support_list
        ],
        at_mm=at.tolist(),
        load_mm=load.tolist(),
        deflection_mm_per_n=[[float(f"{value:.{DIGITS}g}") for value in row] for row in shape],
        sensor_mm=scene.sensors.size_mm,
    )
