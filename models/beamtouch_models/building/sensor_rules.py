"""The rules for sensor positions that a scene states."""

import numpy as np

from beamtouch_models.physics.beam import sensor_positions_mm
from beamtouch_models.placement.layout import Candidates
from beamtouch_models.scene import Scene


def sensor_rules(scene: Scene) -> Candidates:
    """Return the allowed sensor positions of a scene; raises SceneError if its rules leave fewer than two."""
    position = sensor_positions_mm(scene)
    return Candidates(
        position, np.searchsorted(position, np.unique(scene.sensors.fixed_mm)), scene.sensors.min_distance_mm
    )
