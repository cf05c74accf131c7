"""The prior of a model's surface, with its layout, its floor and the departures of its calibration."""

from dataclasses import replace
from functools import partial

import numpy as np

from beamtouch_models.arrays import Floats
from beamtouch_models.design.accuracy.prior import Prior
from beamtouch_models.design.physics.beam import influence
from beamtouch_models.design.scene.beam import Beam, changed_beam
from beamtouch_models.design.surface import resolve_model
from beamtouch_models.places import positions_of
from beamtouch_models.runtime.metadata import Departures, Metadata


def prior_of_model(metadata: Metadata) -> Prior:
    """Return the prior of a model's surface, with its layout, its floor and the departures of its calibration.

    Raises
    ------
    SceneError
        The scene in the model cannot be computed.
    """
    surface, sensor_mm = resolve_model(metadata), metadata.layout_mm
    floor = metadata.floor
    prior = surface.prior(sensor_mm)
    errors = replace(
        prior.errors, noise_mm=metadata.noise.sample_mm, gain=np.array(floor.gain), zero_mm=np.array(floor.zero_mm)
    )
    prior = replace(prior, errors=errors)
    if metadata.calibration is None:
        return prior
    # A calibration finds the positions of the sensors.
    prior = replace(prior, variance_at=None)
    return depart(prior, surface.beam, surface.contact_width_mm, sensor_mm, metadata.calibration.departures)


def depart(prior: Prior, beam: Beam, width_mm: float, sensor_mm: Floats, departures: Departures) -> Prior:
    """Return the prior of a surface that differs from its scene, with its beam, width of contact and sensors.

    Its deflections are linear in the force and hold the gains; `measured` adds curve and offsets.
    """
    real = changed_beam(beam, departures.rigidity, departures.fixity)
    true_mm = departures.sensors_mm(sensor_mm, beam.length_mm)
    influence_at = partial(_real_influence, np.array(departures.gain), real, true_mm, width_mm)
    return replace(prior, influence_at=influence_at, measured=departures.measure)


def _real_influence(gain: Floats, beam: Beam, true_mm: Floats, width_mm: float, place_mm: Floats) -> Floats:
    matrix: Floats = gain * influence(beam, true_mm, positions_of(place_mm), width_mm)
    return matrix
