"""A model made again for a surface with departures: estimator, thresholds, accuracy and golden answers."""

from dataclasses import replace

import numpy as np

from beamtouch_models.accuracy.prior import Prior
from beamtouch_models.building.measure import measure
from beamtouch_models.errors import ModelFileError
from beamtouch_models.estimators.estimator import Estimator, estimator_of
from beamtouch_models.estimators.onnx_graph import to_bytes, with_force_error, with_linear_input
from beamtouch_models.metadata import Calibration, Metadata
from beamtouch_models.names import ESTIMATORS
from beamtouch_models.placement.placing import Aim
from beamtouch_models.surface import Surface
from beamtouch_models.sweeps import Fraction, Progress, silent
from beamtouch_models.world import World


def rebuilt(metadata: Metadata, prior: Prior, calibration: Calibration, progress: Progress) -> tuple[bytes, Metadata]:
    """Return the file of a model with another prior, and its metadata; the prior holds the departures.

    Raises
    ------
    ModelFileError
        This version does not have the model's estimator.
    """
    made = remade(metadata, prior, calibration, lambda done: progress("making the estimator", 0.7 + 0.1 * done))
    progress("measuring the accuracy against the limit", 0.85)
    surface = Surface.of_model(metadata)
    noise_mm, departures = surface.modelled_readings.sensor_mm, calibration.departures
    world = World.of(surface.stated, metadata.sensor, metadata.layout_mm, noise_mm, departures)
    aim = Aim(metadata.placed.criterion, metadata.placed.spare)
    fields = measure(made, prior, surface, world, metadata.seed, aim)
    fresh = metadata.model_copy(update={**vars(fields), "calibration": calibration})
    return to_bytes(made.graph, fresh), fresh


def remade(metadata: Metadata, prior: Prior, calibration: Calibration, progress: Fraction = silent) -> Estimator:
    """Return the estimator of a model for another prior; raises as `rebuilt`."""
    name = next((known for known in ESTIMATORS if known == metadata.estimator), None)
    if name is None:
        raise ModelFileError(f"this version has no estimator {metadata.estimator!r}; build the model again")
    with_force = "force_n" in metadata.golden.answers
    min_noise_mm = metadata.filter.min_noise_mm(metadata.noise)
    made = estimator_of(
        name, prior, min_noise_mm=min_noise_mm, with_force=with_force, seed=metadata.seed, progress=progress
    )
    departures = calibration.departures
    graph = with_linear_input(made.graph, np.array(departures.offset_mm), departures.curve_per_mm)
    return replace(made, graph=with_force_error(graph, calibration.force_error))
