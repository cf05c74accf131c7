"""The prior of a model, rebuilt from its file, and the prior of a surface that departs from its scene."""

from dataclasses import replace
from functools import partial

import numpy as np

from beamtouch_models.accuracy.prior import Prior
from beamtouch_models.arrays import Floats
from beamtouch_models.building.sensor_rules import sample_errors
from beamtouch_models.metadata import Departures, Metadata
from beamtouch_models.physics.beam import influence, influence_of
from beamtouch_models.pricing.effects import Physics, required
from beamtouch_models.scene import parse_scene
from beamtouch_models.scene.beam import Beam, changed_beam


def physics_of(metadata: Metadata) -> Physics:
    """Return the physics that a model was built with; SceneError if its scene is not one."""
    return required(parse_scene(metadata.scene, f"the scene in {metadata.name}"), metadata.filter)


def prior_of_model(metadata: Metadata) -> Prior:
    """Rebuild the prior of a model; raises SceneError as `physics_of`."""
    scene = physics_of(metadata).scene
    sensor_mm = np.array([channel.position_mm for channel in metadata.layout])
    errors = sample_errors(scene, metadata.noise.sample_mm)
    stated = Prior.real(influence_of(scene), sensor_mm, errors)
    prior = replace(stated, gain=np.array(metadata.floor.gain), zero_mm=np.array(metadata.floor.zero_mm))
    if metadata.calibration is None:
        return prior
    # A calibration finds the positions of the sensors.
    prior = replace(prior, uncertain_at=None)
    return departed(prior, scene.beam, scene.contact.width_mm, sensor_mm, metadata.calibration.departures)


def departed(prior: Prior, beam: Beam, width_mm: float, sensor_mm: Floats, departures: Departures) -> Prior:
    """Return the prior of a surface that differs from its scene, with its beam, width of contact and sensors.

    Its deflections are linear in the force and hold the gains; `measured` adds curve and offsets.
    """
    changed = changed_beam(beam, departures.rigidity, departures.fixity)
    true_mm = np.clip(sensor_mm + np.array(departures.position_offset_mm), 0.0, beam.length_mm)
    influence_at = partial(_departed_influence, np.array(departures.gain), changed, true_mm, width_mm)
    return replace(prior, influence_at=influence_at, measured=partial(measured_by, departures))


def _departed_influence(gain: Floats, beam: Beam, true_mm: Floats, width_mm: float, load_mm: Floats) -> Floats:
    matrix: Floats = gain * influence(beam, true_mm, load_mm, width_mm)
    return matrix


def measured_by(departures: Departures, deflection_mm: Floats) -> Floats:
    """Return measured deflections (loads, channels) in mm, from deflections that include the gains."""
    # The root of y + curve y^2 = deflection that is 0 at 0, in the form that does not cancel.
    square = np.maximum(1 + 4 * departures.curve_per_mm * deflection_mm, 0.0)
    reading: Floats = 2 * deflection_mm / (1 + np.sqrt(square)) + np.array(departures.offset_mm)
    return reading
