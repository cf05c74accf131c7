"""Samples at rest that are drawn where they matter, by importance sampling, for the rates at which thresholds fail.

Zeros of whitened samples are uniform within twice their drift, and are drawn with a density that exp(tilt . zero) tilts
(Kahn & Marshall 1953, doi 10.1287/opre.1.5.263). The noise that the samples of a stretch have in common is drawn in any
direction, at any distance r from the origin, evenly; the zeros are drawn along it.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import gammaln

from beamtouch_models.arrays import Floats
from beamtouch_models.design.accuracy.prior import Prior
from beamtouch_models.design.accuracy.thresholds import DRIFTS, MIN_EXPONENT, directions, exceeded_with
from beamtouch_models.runtime.decision.decider import PERSISTENCE
from beamtouch_models.runtime.error_model import whitening
from beamtouch_models.runtime.session import Run

FARTHEST = 14.0
"""Largest r, in deviations."""
MAX_LOG = 700.0
"""Largest exponent of float64."""


@dataclass(frozen=True)
class Rest:
    """Whitened samples at rest, drawn where they look like a contact."""

    zero: Floats
    """(draws, channels), the part that stays for days"""
    noise: Floats
    """(draws, channels)"""
    weight: Floats
    """(draws,), density at rest over that of the draws."""

    @property
    def sample(self) -> Floats:
        """The sum of both."""
        return self.zero + self.noise


def reach_of(noise: Floats) -> Floats:
    """Return the farthest zeros (channels,) of whitened samples with noise of these deviations (channels,)."""
    reach: Floats = DRIFTS * np.sqrt(np.maximum(1 - noise**2, 0.0))
    return reach


def tilted(tilt: Floats, reach: Floats, rng: np.random.Generator) -> Floats:
    """Draw zeros (draws, channels) between -reach and reach with tilts (draws, channels)."""
    power = np.maximum(np.abs(tilt) * reach, MIN_EXPONENT)
    share = rng.random(tilt.shape)
    part = 1 + np.log(share + (1 - share) * np.exp(-2 * power)) / power
    zero: Floats = np.sign(tilt) * part * reach
    return zero


def log_tilt(zero: Floats, tilt: Floats, reach: Floats) -> Floats:
    """Return the log of the tilted over the even density, for zeros and tilts (..., channels)."""
    power = np.maximum(np.abs(tilt) * reach, MIN_EXPONENT)
    mean = power + np.log(-np.expm1(-2 * power)) - np.log(2 * power)
    log: Floats = (zero * tilt).sum(axis=-1) - mean.sum(axis=-1)
    return log


def overlapping_means(largest: Floats, window: int, run: int, rng: np.random.Generator) -> tuple[Floats, int]:
    """Draw means of white readings over the last `window` of them, in deviations of a mean.

    Parameters
    ----------
    largest : (draws, dimensions) normal, however they were drawn: what `run` successive means have in common
    window, run : numbers of readings and of successive means

    Returns (draws, means, dimensions), normal if `largest` is, and the index of the first of the `run` means. As many
    means before and after them are drawn as depend on them.
    """
    readings, margin = window + run - 1, window + run
    means = np.zeros((run, readings))
    for first in range(run):
        means[first, first : first + window] = window**-0.5
    # The least readings that raise all means alike.
    common = np.linalg.solve(means @ means.T, np.ones(run)) @ means
    common /= np.linalg.norm(common)
    drawn = rng.normal(size=(len(largest), readings + 2 * margin, largest.shape[1]))
    middle = drawn[:, margin : margin + readings]
    middle += common[:, None] * (largest - np.einsum("k,dkc->dc", common, middle))[:, None]
    below = np.concatenate([np.zeros_like(drawn[:, :1]), np.cumsum(drawn, axis=1)], axis=1)
    found: Floats = (below[:, window:] - below[:, :-window]) / window**0.5
    return found, margin


def rest_like_contact(unit: Floats, noise: Floats, rate: float, draws: int, seed: int) -> Rest:
    """Draw whitened samples at rest so that about half of them exceed what rest exceeds with probability `rate`.

    `unit` are directions (places, channels), `noise` the deviations of the noise (channels,). A place that does not
    move looks like rest, so nothing is drawn about it.
    """
    rng = np.random.default_rng([seed, unit.shape[1]])
    unit, reach = unit[unit.any(axis=1)], reach_of(noise)
    if not len(unit):
        zero = reach * rng.uniform(-1, 1, size=(draws, len(noise)))
        return Rest(zero, rng.normal(size=zero.shape) * noise, np.ones(draws))
    size = np.linalg.norm(unit * noise, axis=1)
    along = unit * noise / size[:, None]
    height, tilts = exceeded_with(rate, np.abs(unit) * reach, size)
    tilt = tilts[:, None] * unit
    at = np.linspace(0, len(unit) - 1, draws).round().astype(np.intp)
    zero = tilted(tilt[at], reach, rng)
    shift = np.maximum(height - zero @ unit.T, 0.0) / size
    white = rng.normal(size=zero.shape) + np.take_along_axis(shift, at[:, None], axis=1) * along[at]
    drawn = shift * (white @ along.T) - shift**2 / 2 + log_tilt(zero[:, None], tilt, reach)
    return Rest(zero, white * noise, 1 / np.exp(np.minimum(drawn, MAX_LOG)).mean(axis=1))


def exceeding(
    run: Run, prior: Prior, covariance: Floats, kept: tuple[int, ...], rate: float, threshold: float
) -> float:
    """The rate at which rest exceeds a threshold, through the graph, by importance sampling, over what was asked."""
    channels, draws = prior.channels, 2048
    valid = np.zeros((draws, channels), np.bool_)
    valid[:, kept] = True
    weights = whitening(np.zeros((draws, channels)), covariance, 0.0, prior.errors.zero_mm, valid)
    part = weights[0][np.ix_(kept, kept)]
    shapes = prior.influence_table(prior.extent.grid(201))[:, kept] @ part.T
    # What is not noise is the zero.
    noise = np.sqrt(np.diag(part @ covariance[np.ix_(kept, kept)] @ part.T))
    rest = rest_like_contact(directions(shapes), noise, rate, draws, 5)
    reading = np.zeros((draws, channels))
    reading[:, kept] = np.linalg.solve(part, rest.sample.T).T
    odds = run(reading, weights)["contact_log_odds"]
    return float(np.where(odds > threshold, rest.weight, 0.0).mean() / rate)


@dataclass(frozen=True)
class Sequences:
    """Whitened samples of sequences."""

    sample: Floats
    """(draws, samples, dimensions)"""
    weight: Floats
    """(draws,), true density over that of the draws."""
    first: int
    """Index of the first of the samples that are drawn large."""


def at_rest(noise: Floats, window: int, draws: int, seed: int) -> Sequences:
    """Draw sequences at rest whose means are large together; `noise` are deviations (channels,)."""
    rng, channels = np.random.default_rng([seed, len(noise)]), len(noise)
    radius = FARTHEST * (np.arange(draws) + rng.random(draws)) / draws
    toward = rng.normal(size=(draws, channels))
    toward /= np.linalg.norm(toward, axis=1, keepdims=True)
    tilt, reach = radius[:, None] * toward / noise, reach_of(noise)
    zero = tilted(tilt, reach, rng)
    means, first = overlapping_means(radius[:, None] * toward, window, PERSISTENCE, rng)
    density = (channels - 1) * np.log(radius) - radius**2 / 2
    density -= (channels / 2 - 1) * np.log(2) + gammaln(channels / 2)
    weight = FARTHEST * np.exp(density - log_tilt(zero, tilt, reach))
    return Sequences(zero[:, None] + noise * means, weight, first)
