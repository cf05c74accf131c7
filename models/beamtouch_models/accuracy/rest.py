"""Samples at rest, drawn where they matter: zeros within their drift, and means of overlapping windows.

Zeros of whitened samples are uniform within twice their drift. Importance sampling tilts their density by
exp(tilt . zero) (Kahn & Marshall 1953, doi 10.1287/opre.1.5.263).
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import log_ndtr, ndtri

from beamtouch_models.arrays import Floats

DRIFTS = 2.0
"""Farthest a zero lies, in its drifts."""
MIN_EXPONENT = 1e-6
"""Smallest exponent; below it a tilt makes no difference."""
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


def exceeded_with(rate: float, reach: Floats, noise: Floats) -> tuple[Floats, Floats]:
    """Return the heights (sums,) that sums of zeros and noise exceed with probability `rate`, and their tilts.

    A tilt makes the sum that height on average. Both are those of the saddlepoint approximation, which is exact without
    zeros (Daniels, Saddlepoint approximations in statistics, 1954, doi 10.1214/aoms/1177728652).

    Parameters
    ----------
    rate : probability, below a half
    reach : (sums, channels), farthest zeros, which are uniform
    noise : (sums,), standard deviation of the noise in a sum; positive
    """
    low, high = np.zeros(len(noise)), -ndtri(rate) / noise
    for _ in range(50):
        tilt = (low + high) / 2
        height, log_share = _saddlepoint(tilt, reach, noise)
        low, high = np.where(log_share > np.log(rate), tilt, low), np.where(log_share > np.log(rate), high, tilt)
    return height, tilt


def _saddlepoint(tilt: Floats, reach: Floats, noise: Floats) -> tuple[Floats, Floats]:
    """Return the mean (sums,) of tilted sums, and the log of the probability that sums exceed it."""
    power = np.maximum(tilt[:, None] * reach, MIN_EXPONENT)
    log_mean = power + np.log(-np.expm1(-2 * power)) - np.log(2 * power)
    middle = 1 / np.tanh(power) - 1 / power
    spread = 1 + 1 / power**2 - 1 / np.tanh(power) ** 2
    height = (reach * middle).sum(axis=1) + tilt * noise**2
    deviation = tilt * np.sqrt((reach**2 * spread).sum(axis=1) + noise**2)
    log_share = log_mean.sum(axis=1) + (tilt * noise) ** 2 / 2 - tilt * height + deviation**2 / 2
    return height, log_share + log_ndtr(-deviation)


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
