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
from functools import cache, cached_property
from itertools import combinations

import numpy as np
from scipy.special import gammaln

from beamtouch_models.accuracy.prior import Prior
from beamtouch_models.accuracy.rest import log_tilt, overlapping_means, reach_of, tilted
from beamtouch_models.accuracy.touch_thresholds import directions, noise_at_rest, shapes_at_rest
from beamtouch_models.arrays import Bools, Floats
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
MAX_SETS = 8
"""Number of sets of channels of one size that are simulated; they hardly differ."""
PLACES = 4
"""Step between the places of a contact that are looked at."""
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

    @cached_property
    def square(self) -> Floats:
        """Sums of squares (draws, samples)."""
        square: Floats = np.einsum("dsm,dsm->ds", self.sample, self.sample)
        return square


def unexplained_thresholds(prior: Prior, rate_hz: float, window: int, seed: int) -> tuple[list[float], list[float]]:
    """Return the thresholds of rest and of misfit, by the number of valid channels."""
    simulated, rate = int(np.clip(window, *WINDOWS)), _rate_per_sample(PER_DAY, rate_hz, window)
    noise, whole = np.maximum(noise_at_rest(prior), MIN_NOISE), shapes_at_rest(prior)[::PLACES]

    @cache  # sets of channels with the same noise have the same sequences
    def still(deviations: tuple[float, ...]) -> Sequences:
        return at_rest(np.array(deviations), simulated, DRAWS, seed)

    rest, misfit = [], []
    for size in range(1, prior.channels + 1):
        limit = misfit_threshold(float(np.sqrt(np.mean(noise**2))), size, rate_hz, window, seed)
        sets = list(combinations(range(prior.channels), size))
        each = []
        for kept in sets[:: -(-len(sets) // MAX_SETS)]:
            drawn = still(tuple(noise[list(kept)].tolist()))
            odd = squares_if_odd(directions(whole[:, kept]), drawn, limit)
            each.append(max(limit, threshold(drawn, odd, rate)))
        rest.append((max(each) + min(each)) / 2)
        misfit.append(limit)
    return rest, misfit


def misfit_threshold(
    noise: float, channels: int, rate_hz: float, window: int, seed: int, draws: int | None = None
) -> float:
    """Return the threshold of the misfit of one contact, for means of `window` readings of this many channels.

    `noise` is the part of the noise in the deviation of a sample; the rest of its unit variance is the zero.
    """
    noise = max(noise, MIN_NOISE)
    drawn = contacts(np.full(channels, noise), int(np.clip(window, *WINDOWS)), draws or DRAWS, seed)
    return threshold(drawn, drawn.square, _rate_per_sample(PER_DAY_OF_CONTACT, rate_hz, window))


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


def squares_if_odd(unit: Floats, drawn: Sequences, misfit: float) -> Floats:
    """Return the sums of squares (draws, samples) of samples, and 0 where a contact along `unit` explains the sample.

    It is 0 as well for draws without a run of large sums that begins where they are drawn large.
    """
    square = drawn.square
    found: Floats = np.zeros_like(square)
    # Sequences that are not odd where they are drawn large do not count, so they need no search.
    counted = np.flatnonzero(_lasting(square[:, drawn.first :][:, :PERSISTENCE])[:, 0] > misfit)
    large = np.zeros(square.shape, np.bool_)
    large[counted] = square[counted] > misfit
    explained = np.maximum((unit @ drawn.sample[large].T).max(axis=0), 0.0) ** 2
    found[large] = np.where(square[large] - explained > misfit, square[large], 0.0)
    return found


def stretches(drawn: Sequences, odd: Bools) -> float:
    """Return the rate of stretches per sample; `odd` are (draws, samples)."""
    return _rate(drawn, _lasting(odd.astype(np.float64)), 0.5)


def threshold(drawn: Sequences, statistic: Floats, rate: float) -> float:
    """Return the threshold of a statistic (draws, samples) at which stretches begin with probability `rate`."""
    low, high, lasting = 0.0, float(statistic.max()), _lasting(statistic)
    for _ in range(STEPS):
        middle = (low + high) / 2
        above = _rate(drawn, lasting, middle) > rate
        low, high = (middle, high) if above else (low, middle)
    return high


def _lasting(statistic: Floats) -> Floats:
    """Return the level (draws, samples - 2) above which a statistic stays for three samples in a row."""
    found: Floats = np.minimum(np.minimum(statistic[:, :-2], statistic[:, 1:-1]), statistic[:, 2:])
    return found


def _rate(drawn: Sequences, lasting: Floats, level: float) -> float:
    """Return the rate of stretches per sample in which a statistic lies above a level."""
    counted = np.flatnonzero(lasting[:, drawn.first] > level)
    in_each = np.count_nonzero(lasting[counted] > level, axis=1)
    return float((drawn.weight[counted] / in_each).sum() / len(lasting))
