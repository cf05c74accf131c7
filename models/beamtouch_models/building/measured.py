"""Measurements on a finished estimator for its metadata: accuracy, thresholds, smallest force, golden answers."""

from dataclasses import dataclass

import numpy as np

from beamtouch_models.accuracy import limit
from beamtouch_models.accuracy.contacts import simulated_enough
from beamtouch_models.accuracy.prior import Prior
from beamtouch_models.accuracy.statistics import mean_of, ratio_of
from beamtouch_models.accuracy.touch_thresholds import PLACES, rate_per_sample, smallest_forces, touch_thresholds
from beamtouch_models.accuracy.unexplained_thresholds import unexplained_thresholds, windows_of
from beamtouch_models.arrays import Floats
from beamtouch_models.building.since_touch import errors_since_touch
from beamtouch_models.estimators.estimator import Estimator
from beamtouch_models.export import to_bytes
from beamtouch_models.metadata import Accuracy, FilterChoice, Floor, Golden, Influence, SmallestForce, Thresholds
from beamtouch_models.scene import Scene
from beamtouch_models.session import Run, runner
from beamtouch_models.whitening import whitening

ACCURACY_DRAWS = 4_096
GOLDEN_DRAWS = 6
DIGITS = 7
"""Significant digits in this table."""


@dataclass(frozen=True)
class Measured:
    """Fields of the metadata that are measured."""

    thresholds: Thresholds
    smallest_force: SmallestForce
    floor: Floor
    influence: Influence
    accuracy: Accuracy
    golden: Golden


def measured(
    estimator: Estimator, prior: Prior, scene: Scene, sensor_mm: Floats, chosen: FilterChoice, seed: int
) -> Measured:
    """Measure an estimator on simulated samples of its prior, using the three seeds after `seed`.

    `sensor_mm` (channels,) are the positions of the sensors of the prior.
    """
    run = runner(to_bytes(estimator.graph))
    thresholds = thresholds_of(prior, scene, chosen, seed + 1)
    supports_mm = [support.at_mm for support in scene.beam.support_list]
    gain, zero_mm = (np.broadcast_to(value, prior.channels).tolist() for value in (prior.gain, prior.zero_mm))
    return Measured(
        thresholds,
        smallest_forces(prior, thresholds.touch[-1], supports_mm),
        Floor(gain=gain, zero_mm=zero_mm),
        _influence(prior),
        _accuracy(prior, run, scene, sensor_mm, chosen, seed + 2),
        _golden(prior, run, seed + 3),
    )


def _influence(prior: Prior) -> Influence:
    """Return the influence at `PLACES`.

    Cubic interpolation is off by at most 6e-4 of the largest influence of any shipped scene, at the kink that shear
    makes, and by 3e-5 elsewhere.
    """
    table = prior.influence_at(np.linspace(*prior.position_mm, PLACES))
    return Influence(mm_per_n=[[float(f"{value:.{DIGITS}g}") for value in row] for row in table])


def thresholds_of(prior: Prior, scene: Scene, chosen: FilterChoice, seed: int) -> Thresholds:
    """Return the thresholds for the false contacts per day that a scene allows, behind a filter."""
    per_day, rate_hz = scene.requirements.false_contacts_per_day, scene.sensors.rate_hz
    each = [unexplained_thresholds(prior, rate_hz, window, seed) for window in windows_of(chosen)]
    rest, misfit = ([max(limits) for limits in zip(*kind, strict=True)] for kind in zip(*each, strict=True))
    return Thresholds(
        touch=touch_thresholds(prior, rate_per_sample(per_day, rate_hz, chosen.window), seed),
        rest=rest,
        misfit=misfit,
        false_contacts_per_day=per_day,
    )


def _accuracy(prior: Prior, run: Run, scene: Scene, sensor_mm: Floats, chosen: FilterChoice, seed: int) -> Accuracy:
    """Return the error of the exported graph and the accuracy limit, on the same contacts."""
    contacts = simulated_enough(prior, ACCURACY_DRAWS, seed)
    best, weight = contacts.deviation_mm, contacts.weight
    if best is None:
        message = "without noise there is no accuracy limit"
        raise ValueError(message)
    deflection = prior.measured(contacts.drawn.deflection_mm)
    error = contacts.mean_error_mm(run(deflection, prior.whitening(deflection))["position_mm"])
    reached, least = (mean_of(values, weight).scaled(100 / prior.length_mm) for values in (error, best))
    return Accuracy(
        since_touch=errors_since_touch(prior, run, scene, sensor_mm, chosen, reached, seed),
        error_percent=reached.value,
        error_standard_error=reached.standard_error,
        limit_percent=least.value,
        limit_standard_error=least.standard_error,
        ratio_standard_error=ratio_of(error * weight, best * weight).standard_error,
    )


def _golden(prior: Prior, run: Run, seed: int) -> Golden:
    """Return the answers of the graph for a few contacts, one with a channel missing, one unsteady, and for rest."""
    drawn = limit.draw(prior, GOLDEN_DRAWS, seed)
    linear = np.concatenate([drawn.deflection_mm, drawn.deflection_mm[:2], np.zeros((1, prior.channels))])
    deflection = prior.measured(linear)
    covariance = np.tile(np.eye(prior.channels) * prior.noise_mm**2, (len(deflection), 1, 1))
    # A load that has just come: its own deflection scatters.
    covariance[GOLDEN_DRAWS] += np.outer(linear[GOLDEN_DRAWS], linear[GOLDEN_DRAWS]) / 4
    valid = np.ones(deflection.shape, np.bool_)
    if prior.channels > 1:
        valid[GOLDEN_DRAWS + 1, 0], deflection[GOLDEN_DRAWS + 1, 0] = False, 0.0
    weights = whitening(deflection, covariance, prior.gain, prior.zero_mm, valid).astype(np.float32)
    deflection = deflection.astype(np.float32)
    answers = run(deflection, weights)
    return Golden(
        deflection_mm=deflection.astype(float).tolist(),
        whitening_per_mm=weights.astype(float).tolist(),
        answers={name: values.astype(float).tolist() for name, values in answers.items()},
    )
