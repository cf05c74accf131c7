"""The placement problems and the priors that scenes state."""

import numpy as np

from beamtouch_models.accuracy.prior import Prior
from beamtouch_models.arrays import Floats
from beamtouch_models.building.sensor_rules import sample_errors, sensor_rules
from beamtouch_models.physics.beam import influence_of
from beamtouch_models.physics.influence import InfluenceFunction
from beamtouch_models.placement import fewest_sensors
from beamtouch_models.placement.layout import Candidates
from beamtouch_models.scene import Scene


def problem_in(scene: Scene) -> tuple[InfluenceFunction, Candidates]:
    """Influence function of a scene, and its rules for sensors."""
    return influence_of(scene), sensor_rules(scene)


def real_prior(scene: Scene, sensor_mm: Floats, noise_mm: float) -> Prior:
    """Prior of a scene with the errors of its sensors."""
    return Prior.real(influence_of(scene), sensor_mm, sample_errors(scene, noise_mm))


def fewest_mm(scene: Scene, noise_mm: float) -> Floats:
    """Positions of the fewest sensors that meet the requirement of a scene."""
    placement = fewest_sensors(
        *problem_in(scene),
        scene.sensors.count_range,
        wanted_mm=scene.requirements.position_error_mm,
        errors=sample_errors(scene, noise_mm),
        seed=0,
    )
    return np.array(placement.positions_mm)
