"""Measurements on a finished estimator for its metadata: accuracy, threshold of contact, golden answers."""

from dataclasses import dataclass

import numpy as np
import onnx
from onnx.utils import Extractor

from beamtouch_models.accuracy import limit
from beamtouch_models.accuracy.contacts import simulated_enough
from beamtouch_models.accuracy.prior import Prior
from beamtouch_models.accuracy.rest import FALSE_ALARM_RATE, ODDS, contact_threshold
from beamtouch_models.accuracy.statistics import mean_of, ratio_of
from beamtouch_models.estimators.estimator import Estimator
from beamtouch_models.export import to_bytes
from beamtouch_models.metadata import Accuracy, Golden
from beamtouch_models.session import Run, runner

ACCURACY_DRAWS = 4_096
GOLDEN_DRAWS = 8


@dataclass(frozen=True)
class Measured:
    """Fields of the metadata that are measured."""

    contact_threshold: float
    accuracy: Accuracy
    golden: Golden


def measured(estimator: Estimator, prior: Prior, seed: int) -> Measured:
    """Measure an estimator on simulated samples of its prior, using the three seeds after `seed`."""
    run = runner(to_bytes(estimator.graph))
    return Measured(
        contact_threshold(prior, runner(to_bytes(_for_odds(estimator.graph))), seed + 1, FALSE_ALARM_RATE),
        _accuracy(prior, run, seed + 2),
        _golden(prior, run, seed + 3),
    )


def _for_odds(graph: onnx.ModelProto) -> onnx.ModelProto:
    """Return the part of a graph that computes the log odds, which is more than twice as fast; all if it has none."""
    if ODDS not in {output.name for output in graph.graph.output}:
        return graph
    part: onnx.ModelProto = Extractor(graph).extract_model([one.name for one in graph.graph.input], [ODDS])
    return part


def _accuracy(prior: Prior, run: Run, seed: int) -> Accuracy:
    """Return the error of the exported graph and the accuracy limit, on the same contacts."""
    contacts = simulated_enough(prior, ACCURACY_DRAWS, seed)
    best, weight = contacts.deviation_mm, contacts.weight
    if best is None:
        message = "without noise there is no accuracy limit"
        raise ValueError(message)
    deflection = prior.stated(contacts.drawn.deflection_mm).astype(np.float32)
    error = contacts.mean_error_mm(run(deflection, np.ones(deflection.shape, np.bool_))["position_mm"])
    reached, least = (mean_of(values, weight).scaled(100 / prior.length_mm) for values in (error, best))
    return Accuracy(
        error_percent=reached.value,
        error_standard_error=reached.standard_error,
        limit_percent=least.value,
        limit_standard_error=least.standard_error,
        ratio_standard_error=ratio_of(error * weight, best * weight).standard_error,
    )


def _golden(prior: Prior, run: Run, seed: int) -> Golden:
    """Return the answers of the graph for a few contacts and a beam at rest."""
    drawn = limit.draw(prior, GOLDEN_DRAWS, seed)
    linear = np.concatenate([drawn.deflection_mm, np.zeros((1, prior.channels))])
    deflection = prior.stated(linear).astype(np.float32)
    valid = np.ones(deflection.shape, np.bool_)
    answers = run(deflection, valid)
    return Golden(
        deflection_mm=deflection.astype(float).tolist(),
        valid=valid.tolist(),
        answers={name: values.astype(float).tolist() for name, values in answers.items()},
    )
