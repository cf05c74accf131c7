"""The prior of a model's surface, with its layout, its floor and the departures of its calibration."""

from dataclasses import replace
from functools import partial

import numpy as np

from beamtouch_models.arrays import Floats
from beamtouch_models.design.accuracy.prior import Prior
from beamtouch_models.design.physics.measured_structure import MeasuredStructure
from beamtouch_models.design.physics.structure import Structure, changed, influence, size_of
from beamtouch_models.design.surface import resolve_model
from beamtouch_models.places import as_stated, on_axis
from beamtouch_models.runtime.departures import Departures
from beamtouch_models.runtime.metadata import Metadata


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
    return depart(prior, surface.structure, surface.contact_width_mm, sensor_mm, metadata.calibration.departures)


def depart(prior: Prior, structure: Structure, width_mm: float, sensor_mm: Floats, departures: Departures) -> Prior:
    """Return the prior of a surface that differs from its scene, with its structure, width of contact and sensors.

    Its deflections are linear in the force and hold the gains; `measured` adds curve and offsets. What a calibration
    finds of a beam or a plate are also the places of its sensors. What the table of a measured structure leaves open
    stays.
    """
    real = changed(structure, departures)
    true_mm, gain = departures.sensors_mm(sensor_mm, size_of(structure)), np.array(departures.gain)
    influence_at = partial(_real_influence, gain, real, true_mm, width_mm)
    variance_at = None
    if isinstance(real, MeasuredStructure) and prior.variance_at is not None:
        variance_at = partial(_real_variance, gain, real, true_mm)
    return replace(prior, influence_at=influence_at, variance_at=variance_at, measured=departures.measure)


def _real_influence(gain: Floats, structure: Structure, true_mm: Floats, width_mm: float, place_mm: Floats) -> Floats:
    matrix: Floats = gain * influence(structure, true_mm, as_stated(place_mm), width_mm)
    return matrix


def _real_variance(gain: Floats, structure: MeasuredStructure, true_mm: Floats, place_mm: Floats) -> Floats:
    variance: Floats = gain**2 * structure.variance(on_axis(true_mm), place_mm)
    return variance
