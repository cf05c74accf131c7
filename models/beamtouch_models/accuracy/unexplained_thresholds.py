"""Thresholds of `unexplained`: sums of squares that rest, and one contact, exceed in one false stretch a day.

A stretch begins with three odd samples in a row. The means of overlapping windows are hardly ever odd alone, so that
the thresholds are well below the quantiles of chi-square for a single sample. As for touch, the rate is that of the
noise, averaged over zeros within twice their drift. The gain error of a load counts like a zero, because it stays as
long as the load does.

A contact fits two directions of the errors: its own, and that of its change with the position. So of two channels it
leaves no direction. But contacts of two channels lie within a cone, between the directions of the contacts at either
end of the range. A contact at the edge of the cone leaves the errors on one side of it, half of those of one direction.
A contact in a narrow cone leaves those on both sides, which are at most those of one direction. So one direction is the
bound.

The rate follows by importance sampling over sequences of samples. The noise that three samples have in common is drawn
in any direction, at any distance r from the origin, evenly; the zeros are drawn along it. A stretch in which k runs of
three begin is found k times and counts 1/k.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import gammaln

from beamtouch_models.accuracy.prior import Prior
from beamtouch_models.accuracy.rest import log_tilt, overlapping_means, reach_of, tilted
from beamtouch_models.accuracy.touch_thresholds import noise_at_rest
from beamtouch_models.arrays import Floats
from beamtouch_models.decision.decider import PERSISTENCE
from beamtouch_models.metadata import FilterChoice
from beamtouch_models.rates import SECONDS_PER_DAY

PER_DAY = 1.0
"""False stretches per day of rest."""
PER_DAY_OF_CONTACT = 0.5
"""False stretches per day of a contact, half of those at rest: weak contacts and contacts near an end of the range fit
fewer than two directions of the errors, which makes up to three times as many stretches."""
MAX_ALIKE = 24
"""Readings in a growing mean that make false stretches about as frequent as they become: successive samples share most
of their readings, and stretches still begin often."""
MAX_RATE_PER_SAMPLE = 0.01
"""Largest rate per sample; above it, a misfit no longer tells anything."""
FARTHEST = 14.0
"""Largest r, in deviations."""
WINDOWS = 2, 64
"""Windows that are simulated. Samples of single readings are odd together less often than means of two. In longer
windows than the largest, false stretches are as frequent per window."""
DRAWS = 8192
MIN_NOISE = 0.1
"""Smallest part of the noise in the error of a sample. Below it the zeros decide: thresholds fall by less than a sixth,
and too few draws come near them."""
STEPS = 30


@dataclass(frozen=True)
class Sequences:
    """Whitened samples of sequences."""

    sample: Floats
    """(draws, samples, dimensions)"""
    weight: Floats
    """(draws,), true density over that of the draws."""
    first: int
    """Index of the first of the samples that are drawn large."""


def unexplained_thresholds(prior: Prior, rate_hz: float, window: int, seed: int) -> tuple[list[float], list[float]]:
    """Return the thresholds of rest and of misfit, by the number of valid channels.

    Sets of channels of one size hardly differ. A sample is odd if it exceeds both; that of rest is chosen as if it were
    alone, so that false stretches are rarer than stated.
    """
    noise = float(np.sqrt(np.mean(np.maximum(noise_at_rest(prior), MIN_NOISE) ** 2)))
    rest, misfit = [], []
    for size in range(1, prior.channels + 1):
        drawn = at_rest(np.full(size, noise), int(np.clip(window, *WINDOWS)), DRAWS, seed)
        misfit.append(misfit_threshold(noise, size, rate_hz, window, seed))
        rest.append(max(misfit[-1], _threshold(drawn, _rate_per_sample(PER_DAY, rate_hz, window))))
    return rest, misfit


def misfit_threshold(
    noise: float, channels: int, rate_hz: float, window: int, seed: int, draws: int | None = None
) -> float:
    """Return the threshold of the misfit of one contact, for means of `window` readings of this many channels.

    `noise` is the part of the noise in the deviation of a sample; the rest of its unit variance is the zero.
    """
    noise = max(noise, MIN_NOISE)
    drawn = contacts(np.full(channels, noise), int(np.clip(window, *WINDOWS)), draws or DRAWS, seed)
    return _threshold(drawn, _rate_per_sample(PER_DAY_OF_CONTACT, rate_hz, window))


def windows_of(chosen: FilterChoice) -> tuple[int, ...]:
    """Return the numbers of readings in a mean for which the thresholds of misfit hold, ascending."""
    return tuple(sorted({chosen.window, min(chosen.max_readings, MAX_ALIKE)}))


def _rate_per_sample(per_day: float, rate_hz: float, window: int) -> float:
    """Return the rate of stretches per sample; in windows longer than those simulated, it is that per window."""
    return min(per_day * max(1.0, window / WINDOWS[1]) / (SECONDS_PER_DAY * rate_hz), MAX_RATE_PER_SAMPLE)


def left_by_contact(channels: int) -> int:
    """Return the number of directions of the errors that a contact leaves unexplained at most."""
    return max(1, channels - 2)


def at_rest(noise: Floats, window: int, draws: int, seed: int) -> Sequences:
    """Draw sequences at rest whose means are large together; `noise` are deviations (channels,)."""
    basis = np.broadcast_to(np.eye(len(noise)), (draws, len(noise), len(noise)))
    return _sequences(basis, noise, window, np.random.default_rng([seed, len(noise)]))


def contacts(noise: Floats, window: int, draws: int, seed: int) -> Sequences:
    """Draw what contacts leave unexplained, (draws, samples, directions): errors in any directions but two."""
    rng = np.random.default_rng([seed, len(noise)])
    basis, _ = np.linalg.qr(rng.normal(size=(draws, len(noise), left_by_contact(len(noise)))))
    return _sequences(basis, noise, window, rng)


def _sequences(basis: Floats, noise: Floats, window: int, rng: np.random.Generator) -> Sequences:
    """Draw sequences in the space of a basis (draws, channels, dimensions)."""
    draws, _, dimensions = basis.shape
    radius = FARTHEST * (np.arange(draws) + rng.random(draws)) / draws
    toward = rng.normal(size=(draws, dimensions))
    toward /= np.linalg.norm(toward, axis=1, keepdims=True)
    tilt, reach = radius[:, None] * np.einsum("dcm,dm->dc", basis, toward) / noise, reach_of(noise)
    zero = tilted(tilt, reach, rng)
    means, first = overlapping_means(radius[:, None] * toward, window, PERSISTENCE, rng)
    sample = np.einsum("dcm,dc->dm", basis, zero)[:, None] + noise[:dimensions] * means
    density = (dimensions - 1) * np.log(radius) - radius**2 / 2
    density -= (dimensions / 2 - 1) * np.log(2) + gammaln(dimensions / 2)
    return Sequences(sample, FARTHEST * np.exp(density - log_tilt(zero, tilt, reach)), first)


def _threshold(drawn: Sequences, rate: float) -> float:
    """Return the sum of squares that three samples in a row exceed at the beginning of a stretch, with this rate."""
    square = np.einsum("dsm,dsm->ds", drawn.sample, drawn.sample)
    # The level (draws, samples - 2) above which three samples in a row stay.
    lasting = np.minimum(np.minimum(square[:, :-2], square[:, 1:-1]), square[:, 2:])
    low, high = 0.0, float(square.max())
    for _ in range(STEPS):
        middle = (low + high) / 2
        counted = np.flatnonzero(lasting[:, drawn.first] > middle)
        in_each = np.count_nonzero(lasting[counted] > middle, axis=1)
        is_above = (drawn.weight[counted] / in_each).sum() / len(lasting) > rate
        low, high = (middle, high) if is_above else (low, middle)
    return high
