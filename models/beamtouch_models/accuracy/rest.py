"""The threshold of contact, and the probability that a beam at rest exceeds it."""

import numpy as np
from scipy.special import chdtri

from beamtouch_models.accuracy.limit import SCRAMBLINGS, spread_noise
from beamtouch_models.accuracy.prior import Prior
from beamtouch_models.accuracy.statistics import mean_of
from beamtouch_models.arrays import Floats
from beamtouch_models.session import CHUNK, Run

REST_DRAWS = 2**18
ODDS = "contact_log_odds"
FALSE_ALARM_RATE = 1e-6
"""Share of samples at rest that may exceed the threshold of contact."""


def contact_threshold(prior: Prior, run: Run, seed: int, rate: float) -> float:
    """Return the log odds that a sample at rest exceeds with probability `rate`; 0 if the estimator gives no odds."""
    odds, weight = _rest(prior, run, seed, rate)
    if odds is None:
        return 0.0
    order = np.argsort(-odds)
    exceeded = np.cumsum(weight[order]) / len(odds)
    return float(odds[order][np.searchsorted(exceeded, rate)])


def rest_exceeding(prior: Prior, run: Run, seed: int, threshold: float) -> tuple[float, float]:
    """Return the probability that the log odds of a sample at rest exceed a threshold, and its standard error."""
    odds, weight = _rest(prior, run, seed, FALSE_ALARM_RATE)
    if odds is None:
        message = "the estimator gives no log odds of contact"
        raise ValueError(message)
    found = mean_of(np.where(odds > threshold, weight, 0.0))
    return found.value, found.standard_error


def _rest(prior: Prior, run: Run, seed: int, rate: float) -> tuple[Floats | None, Floats]:
    """Return log odds of samples at rest, (draws,) or None if the estimator gives none, and their weights.

    Importance sampling: samples are drawn with more noise than they have, so that rare ones become common, and their
    weights restore the true distribution (Kahn & Marshall 1953, doi 10.1287/opre.1.5.263).
    """
    rngs = np.random.default_rng(seed).spawn(SCRAMBLINGS)
    # Noise of this total size, over all channels, occurs with probability `rate`.
    widening = np.sqrt(max(1.0, chdtri(prior.channels, rate) / prior.channels))
    each = REST_DRAWS // SCRAMBLINGS
    noise = widening * np.concatenate([spread_noise(prior.channels, each, rng) for rng in rngs])
    weight: Floats = np.exp(-(noise**2).sum(axis=1) / 2 * (1 - widening**-2) + prior.channels * np.log(widening))
    deflection = prior.stated(noise * prior.noise_mm).astype(np.float32)
    odds = []
    for start in range(0, REST_DRAWS, CHUNK):
        part = deflection[start : start + CHUNK]
        answers = run(part, np.ones(part.shape, np.bool_))
        if ODDS not in answers:
            return None, weight
        odds.append(answers[ODDS].astype(np.float64))
    return np.concatenate(odds), weight
