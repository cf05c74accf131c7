"""The placement problems and the priors that scenes state."""

import numpy as np

from beamtouch_models import InfluenceFunction
from beamtouch_models.arrays import Floats
from beamtouch_models.design.accuracy.prior import Prior
from beamtouch_models.design.physics.beam import influence_of
from beamtouch_models.design.placement.layout_rules import LayoutRules
from beamtouch_models.design.placement.placing import fewest_sensors
from beamtouch_models.design.placement.position_error import Sampling
from beamtouch_models.design.scene import Scene
from beamtouch_models.design.surface import resolve, rules_of
from beamtouch_models.places import on_axis
from beamtouch_models.runtime.error_model import Errors


def problem_in(scene: Scene) -> tuple[InfluenceFunction, LayoutRules]:
    """Influence function of a scene, and its rules for sensors."""
    return influence_of(scene), rules_of(scene, np.array([scene.beam.length_mm]))


def errors_in(scene: Scene, noise_mm: float) -> Errors:
    """Errors of a sample with this noise, all that a scene states."""
    readings = resolve(scene).readings
    return Errors(noise_mm, readings.gain, readings.floor_mm, scene.sensors.mounting_tolerance_mm)


def real_prior(scene: Scene, sensor_mm: Floats, noise_mm: float) -> Prior:
    """Prior of a scene with the errors of its sensors."""
    return Prior.of(influence_of(scene), on_axis(sensor_mm), errors_in(scene, noise_mm))


def fewest_mm(scene: Scene, noise_mm: float) -> Floats:
    """Positions of the fewest sensors that meet the requirement of a scene."""
    placement = fewest_sensors(
        *problem_in(scene),
        scene.sensors.count_range,
        wanted_mm=scene.requirements.position_error_mm,
        sampling=Sampling(errors_in(scene, noise_mm)),
        seed=0,
    )
    return np.array(placement.positions_mm)
