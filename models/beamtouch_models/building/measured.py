"""What is measured of a finished estimator before it becomes a model file: accuracy, threshold, golden answers."""

from dataclasses import dataclass

import numpy as np
import onnx
from numpy.typing import NDArray
from onnx.utils import Extractor
from scipy.special import chdtri

from beamtouch_models.accuracy import limit
from beamtouch_models.accuracy.contacts import simulated_enough
from beamtouch_models.accuracy.figures import mean_of, ratio_of
from beamtouch_models.accuracy.prior import Prior
from beamtouch_models.estimators.estimator import Estimator
from beamtouch_models.estimators.running import CHUNK, Run, runner
from beamtouch_models.export import to_bytes
from beamtouch_models.modelfile import Accuracy, Golden

Array = NDArray[np.float64]
ACCURACY_DRAWS = 4_096
REST_DRAWS = 2**18
GOLDEN_DRAWS = 8
ODDS = "contact_log_odds"
FALSE_ALARM_RATE = 1e-6
"""Samples at rest that the threshold lets pass for a contact."""


@dataclass(frozen=True)
class Measured:
    """Fields of the metadata."""

    contact_threshold: float
    accuracy: Accuracy
    golden: Golden


def measured(estimator: Estimator, prior: Prior, seed: int) -> Measured:
    """Measure an estimator on simulated samples of its prior; draws with the three seeds after `seed`."""
    run = runner(to_bytes(estimator.graph))
    return Measured(
        contact_threshold(prior, runner(to_bytes(_for_odds(estimator.graph))), seed + 1, FALSE_ALARM_RATE),
        _accuracy(prior, run, seed + 2),
        _golden(prior, run, seed + 3),
    )


def _for_odds(graph: onnx.ModelProto) -> onnx.ModelProto:
    """Only what the log odds need, which takes less than half the time; all of a graph that offers none."""
    if ODDS not in {output.name for output in graph.graph.output}:
        return graph
    part: onnx.ModelProto = Extractor(graph).extract_model([one.name for one in graph.graph.input], [ODDS])
    return part


def contact_threshold(prior: Prior, run: Run, seed: int, rate: float) -> float:
    """Log odds that a sample at rest exceeds with probability `rate`; 0 where the estimator offers none."""
    odds, weight = _rest(prior, run, seed, rate)
    if odds is None:
        return 0.0
    order = np.argsort(-odds)
    exceeded = np.cumsum(weight[order]) / len(odds)
    return float(odds[order][np.searchsorted(exceeded, rate)])


def rest_exceeding(prior: Prior, run: Run, seed: int, threshold: float) -> tuple[float, float]:
    """Probability that a sample at rest exceeds a threshold of the log odds, and its standard error."""
    odds, weight = _rest(prior, run, seed, FALSE_ALARM_RATE)
    if odds is None:
        message = "the estimator gives no log odds of contact"
        raise ValueError(message)
    found = mean_of(np.where(odds > threshold, weight, 0.0))
    return found.value, found.standard_error


def _rest(prior: Prior, run: Run, seed: int, rate: float) -> tuple[Array | None, Array]:
    """Log odds of samples at rest (draws,), or None where there are none, and the weight of each.

    By importance sampling: rest is drawn with more noise than it has, so that rare samples are common, and each is
    weighed by how likely it really is (Kahn & Marshall 1953, doi 10.1287/opre.1.5.263).
    """
    rngs = np.random.default_rng(seed).spawn(limit.SCRAMBLINGS)
    # Noise of so many channels that is this large in all is as rare as `rate`.
    widening = np.sqrt(max(1.0, chdtri(prior.channels, rate) / prior.channels))
    each = REST_DRAWS // limit.SCRAMBLINGS
    noise = widening * np.concatenate([limit.spread_noise(prior.channels, each, rng) for rng in rngs])
    weight: Array = np.exp(-(noise**2).sum(axis=1) / 2 * (1 - widening**-2) + prior.channels * np.log(widening))
    deflection = prior.stated(noise * prior.noise_mm).astype(np.float32)
    odds = []
    for start in range(0, REST_DRAWS, CHUNK):
        part = deflection[start : start + CHUNK]
        answers = run(part, np.ones(part.shape, np.bool_))
        if ODDS not in answers:
            return None, weight
        odds.append(answers[ODDS].astype(np.float64))
    return np.concatenate(odds), weight


def _accuracy(prior: Prior, run: Run, seed: int) -> Accuracy:
    """Error of the exported graph and the accuracy limit, on the same contacts."""
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
    """A few contacts and a beam at rest, with what the graph answers."""
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
