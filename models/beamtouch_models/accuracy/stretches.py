"""Thresholds of `unexplained`: sums of squares that rest, and one contact, exceed in one false stretch a day.

A stretch begins with three odd samples in a row. The means of overlapping windows are hardly ever odd alone, so that
the thresholds are well below the quantiles of chi-square for a single sample. As for touch, the rate is that of the
noise, averaged over zeros within twice their drift. The gain error of a load counts like a zero, because it stays as
long as the load does.

The rate follows by importance sampling over sequences of samples. The noise that three samples have in common is drawn
in any direction, at any distance r from the origin, evenly; the zeros are drawn along it. A stretch in which k runs of
three begin is found k times and counts 1/k.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.special import chdtri, gammaln

from beamtouch_models.accuracy.prior import Prior
from beamtouch_models.accuracy.touch import SECONDS_PER_DAY, directions, log_odds, noise_at_rest, shapes_at_rest
from beamtouch_models.accuracy.windows import overlapping_means
from beamtouch_models.accuracy.zeros import log_tilt, reach_of, tilted
from beamtouch_models.arrays import Bools, Floats

IN_A_ROW = 3
"""Odd samples in a row with which a stretch begins."""
PER_DAY = 1.0
"""False stretches per day of rest."""
PER_DAY_OF_CONTACT = 0.5
"""False stretches per day of a contact. Weak contacts and those near an end of the range leave more than two channels
fewer unexplained, which makes up to three times as many."""
MOST_OFTEN = 0.01
"""Largest rate per sample; above it, a misfit no longer tells anything."""
FARTHEST = 14.0
"""Largest r, in deviations."""
WINDOWS = 2, 64
"""Windows that are simulated. Samples of single readings are odd together less often than means of two. In longer
windows than the largest, false stretches are as frequent per window."""
DRAWS = 8192
MAX_SETS = 8
"""Number of sets of channels of one size that are simulated; they hardly differ."""
FEW_DRAWS = 2048
"""Sequences for two channels or one, whose threshold of rest seldom follows from them."""
SELDOM = 1e-3
"""Part of the samples of a contact that is just no touch which may be odd; three in a row begin a stretch."""
PLACES = 4
"""Every so many places of a contact are looked at."""
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


def unexplained_thresholds(
    prior: Prior, rate_hz: float, window: int, touch: Sequence[float], seed: int
) -> tuple[list[float], list[float | None]]:
    """Return the thresholds of rest and of misfit, by the number of valid channels.

    `touch` are the thresholds of touch. Two channels or fewer fit most contacts, so that there is no misfit. They are
    odd if rest is refuted and there is no touch, so their threshold of rest is above every contact that is no touch.
    """
    simulated = int(np.clip(window, *WINDOWS))
    per_sample = max(1.0, window / simulated) / (SECONDS_PER_DAY * rate_hz)
    rate, often = (min(per_day * per_sample, MOST_OFTEN) for per_day in (PER_DAY, PER_DAY_OF_CONTACT))
    noise, whole = noise_at_rest(prior), shapes_at_rest(prior)[::PLACES]
    rest, misfit = [], list[float | None]()
    for size in range(1, prior.channels + 1):
        if size <= 2:
            rest.append(_rest_of_few(whole, noise, simulated, size, touch[size - 1], rate, seed))
            misfit.append(None)
            continue
        contact = contacts(np.full(size, np.sqrt(np.mean(noise**2))), simulated, DRAWS, seed)
        limit = threshold(contact, (contact.sample**2).sum(axis=2), often)
        sets = list(combinations(range(prior.channels), size))
        each = []
        for kept in sets[:: -(-len(sets) // MAX_SETS)]:
            still = at_rest(noise[list(kept)], simulated, DRAWS, seed)
            odd = squares_if_odd(directions(whole[:, kept]), still.sample, limit)
            each.append(max(limit, threshold(still, odd, rate)))
        rest.append((max(each) + min(each)) / 2)
        misfit.append(limit)
    return rest, misfit


def _rest_of_few(whole: Floats, noise: Floats, window: int, size: int, touch: float, rate: float, seed: int) -> float:
    """Return the threshold of rest for two channels or one; `whole` are shapes (places, channels)."""
    least = []
    for kept in combinations(range(len(noise)), size):
        still = at_rest(noise[list(kept)], window, FEW_DRAWS, seed)
        least.append(threshold(still, (still.sample**2).sum(axis=2), rate))
        unseen = largest_unseen(directions(whole[:, kept]), touch)
        # Noise beside the direction of the contact adds to its square, and not to its log odds.
        least.append(unseen + (float(chdtri(size - 1, SELDOM)) if size > 1 else 0.0))
    return max(least)


def largest_unseen(unit: Floats, touch: float) -> float:
    """Return the largest sum of squares of a contact in directions (places, channels) that is no touch."""
    unit = unit[np.linalg.norm(unit, axis=1) > 0]
    low, high = np.full(len(unit), 2 * touch), np.full(len(unit), 2 * (touch + np.log(max(1, len(unit)))))
    for _ in range(STEPS):
        middle = (low + high) / 2
        seen = log_odds(unit, np.sqrt(middle)[:, None] * unit) > touch
        low, high = np.where(seen, low, middle), np.where(seen, middle, high)
    return float(high.max(initial=2 * touch))


def at_rest(noise: Floats, window: int, draws: int, seed: int) -> Sequences:
    """Draw sequences at rest whose means are large together; `noise` are deviations (channels,)."""
    basis = np.broadcast_to(np.eye(len(noise)), (draws, len(noise), len(noise)))
    return _sequences(basis, noise, window, np.random.default_rng([seed, len(noise)]))


def contacts(noise: Floats, window: int, draws: int, seed: int) -> Sequences:
    """Draw what contacts leave unexplained, (draws, samples, channels - 2): errors in any directions but two."""
    rng = np.random.default_rng([seed, len(noise)])
    basis, _ = np.linalg.qr(rng.normal(size=(draws, len(noise), len(noise) - 2)))
    return _sequences(basis, noise, window, rng)


def _sequences(basis: Floats, noise: Floats, window: int, rng: np.random.Generator) -> Sequences:
    """Draw sequences in the space of a basis (draws, channels, dimensions)."""
    draws, _, dimensions = basis.shape
    radius = FARTHEST * (np.arange(draws) + rng.random(draws)) / draws
    toward = rng.normal(size=(draws, dimensions))
    toward /= np.linalg.norm(toward, axis=1, keepdims=True)
    tilt, reach = radius[:, None] * np.einsum("dcm,dm->dc", basis, toward) / noise, reach_of(noise)
    zero = tilted(tilt, reach, rng)
    means, first = overlapping_means(radius[:, None] * toward, window, IN_A_ROW, rng)
    sample = np.einsum("dcm,dc->dm", basis, zero)[:, None] + noise[:dimensions] * means
    density = (dimensions - 1) * np.log(radius) - radius**2 / 2
    density -= (dimensions / 2 - 1) * np.log(2) + gammaln(dimensions / 2)
    return Sequences(sample, FARTHEST * np.exp(density - log_tilt(zero, tilt, reach)), first)


def squares_if_odd(unit: Floats, sample: Floats, misfit: float) -> Floats:
    """Return the sum of squares of samples (draws, samples, channels), and 0 where a contact explains the sample."""
    square: Floats = (sample**2).sum(axis=2)
    found: Floats = np.zeros_like(square)
    large = square > misfit
    explained = np.maximum(sample[large] @ unit.T, 0.0).max(axis=1) ** 2
    found[large] = np.where(square[large] - explained > misfit, square[large], 0.0)
    return found


def stretches(drawn: Sequences, odd: Bools) -> float:
    """Return the rate of stretches per sample; `odd` are (draws, samples)."""
    begun = odd[:, :-2] & odd[:, 1:-1] & odd[:, 2:]
    return float(np.mean(drawn.weight * begun[:, drawn.first] / np.maximum(begun.sum(axis=1), 1)))


def threshold(drawn: Sequences, statistic: Floats, rate: float) -> float:
    """Return the threshold of a statistic (draws, samples) at which stretches begin with probability `rate`."""
    low, high = 0.0, float(statistic.max())
    for _ in range(STEPS):
        middle = (low + high) / 2
        above = stretches(drawn, statistic > middle) > rate
        low, high = (middle, high) if above else (low, middle)
    return high
