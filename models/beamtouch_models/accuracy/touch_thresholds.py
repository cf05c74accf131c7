"""Thresholds of touch: the log odds that a beam at rest exceeds at a stated rate, and the smallest force above them.

A whitened sample at rest is y = zero + noise, with unit variance in every direction if the zero were drawn anew for
each sample. But a zero is constant over days. So the rate is that of the noise, averaged over zeros that lie anywhere
within twice their drift, evenly. A contact at position x moves y along the unit vector u(x), so its log odds are
log(mean over x of exp(max(u(x) . y, 0)^2 / 2)): they depend on the directions only.

The odds exceed T about as often as u(x) . y exceeds sqrt(2 T), on average over x. For noise alone this is exact up to a
share of 1 / T, whatever the path of u: a longer path comes near more samples, and a smaller part of it lies near each
(the tube around a path, Hotelling 1939, doi 10.2307/2371512, times the width of the peak by Laplace's method). Zeros
are bounded, so that the odds exceed T more rarely than that. A sample with more noise than a settled one exceeds it
about as often, as its zero counts for less.
"""

from collections.abc import Iterable

import numpy as np
from scipy.special import logsumexp, ndtr, ndtri

from beamtouch_models.accuracy.prior import Prior
from beamtouch_models.accuracy.rest import exceeded_with, reach_of
from beamtouch_models.arrays import Floats
from beamtouch_models.metadata import SmallestForce
from beamtouch_models.rates import MAX_FALSE, SECONDS_PER_DAY

PLACES = 129
"""Positions at which a contact is looked for; the odds change little between them."""
BLIND = 10.0
"""Where more than this many times the largest force is needed, nothing is seen: at a support, or right beside it."""
FLAT = 1e-9
"""Deflection over the largest one below which a place does not move: a support, where only rounding is left."""
SURELY = 1.645
"""Deviations of a sample that a force must exceed the threshold by, so that 95 % of the samples do."""
MIN_NOISE = 1e-5
"""Smallest part of the noise in the error of a sample; below it, the zeros alone decide what rest exceeds."""


def rate_per_sample(per_day: float, rate_hz: float, window: int) -> float:
    """Return the probability that a sample at rest is taken for a contact, for a number of false contacts per day.

    Means of overlapping windows exceed a threshold in clusters. A cluster is one contact. Its mean size follows from
    the overshoot of a random walk (Siegmund, Sequential Analysis, 1985, sec. 8.4).
    """
    wanted = per_day / (SECONDS_PER_DAY * rate_hz)
    rate = min(wanted, MAX_FALSE)
    for _ in range(4):
        height = -float(ndtri(rate))
        # Half of what the height times the change between two samples comes to, in deviations of the mean.
        half = height / np.sqrt(2 * window)
        density = np.exp(-(half**2) / 2) / np.sqrt(2 * np.pi)
        overshoot = (ndtr(half) - 0.5) / half / (half * ndtr(half) + density)
        separate = min(1.0, 2 * half**2 * float(overshoot))
        rate = min(wanted / separate, MAX_FALSE)
    return rate


def touch_thresholds(prior: Prior, rate: float) -> list[float]:
    """Return the log odds that rest exceeds with probability `rate` per sample, by the number of valid channels.

    The threshold of a size is that of its worst set. It is one of neighbours, the last beside the first: they share a
    contact the most evenly, so that the most zeros add up.
    """
    whole, noise, every = shapes_at_rest(prior), noise_at_rest(prior), np.arange(prior.channels)
    sets = [[np.roll(every, -first)[:size] for first in every] for size in every + 1]
    return [max(touch_threshold(directions(whole[:, kept]), noise[kept], rate) for kept in each) for each in sets]


def touch_threshold(unit: Floats, noise: Floats, rate: float) -> float:
    """Return the log odds that rest exceeds with probability `rate`.

    `unit` are directions (places, channels), `noise` the deviations of the noise (channels,). A place that does not
    move looks like rest, and counts for nothing.
    """
    unit = unit[unit.any(axis=1)]
    if not len(unit):
        return 0.0
    heights, tilts = exceeded_with(rate, np.abs(unit) * reach_of(noise), np.linalg.norm(unit * noise, axis=1))
    # The height that the directions exceed with this probability on average: beyond it, tails fall exponentially.
    height = logsumexp(tilts.mean() * heights, b=1 / len(heights)) / tilts.mean()
    return float(height**2 / 2)


def shapes_at_rest(prior: Prior, position_mm: Floats | None = None) -> Floats:
    """Return the influence over the errors of a sample at rest, (places, channels) per newton.

    It is that at PLACES along the range, from the table, or at positions (places,).
    """
    if position_mm is None:
        matrix = prior.table(np.linspace(*prior.position_mm, PLACES))
    else:
        matrix = prior.influence_at(position_mm)
    shapes: Floats = matrix / prior.rest_mm
    return shapes


def noise_at_rest(prior: Prior) -> Floats:
    """Return the deviation (channels,) of the noise of a whitened sample; the rest of its unit variance is the zero."""
    share: Floats = np.maximum(prior.noise_mm / prior.rest_mm, MIN_NOISE)
    return share


def directions(shapes: Floats) -> Floats:
    """Return the unit vectors (places, channels) of shapes; zero where nothing moves."""
    size = np.linalg.norm(shapes, axis=1, keepdims=True)
    unit: Floats = np.divide(shapes, size, out=np.zeros_like(shapes), where=size > FLAT * size.max(initial=0.0))
    return unit


def log_odds(unit: Floats, sample: Floats) -> Floats:
    """Return the log odds (draws,) of whitened samples (draws, channels) for directions (places, channels)."""
    square = np.maximum(sample @ unit.T, 0.0) ** 2 / 2
    largest = square.max(axis=1, keepdims=True)
    odds: Floats = largest[:, 0] + np.log(np.exp(square - largest).mean(axis=1))
    return odds


def smallest_force_n(prior: Prior, threshold: float, position_mm: Floats) -> Floats:
    """Return the force at positions (positions,) of which 95 % of settled samples are a contact; all channels work.

    It is infinite where no sensor moves.
    """
    unit, along = directions(shapes_at_rest(prior)), directions(shapes_at_rest(prior, position_mm))
    low, high = np.zeros(len(position_mm)), np.full(len(position_mm), 2 * np.sqrt(2 * threshold) + 8)
    for _ in range(30):
        middle = (low + high) / 2
        above = log_odds(unit, middle[:, None] * along) > threshold
        low, high = np.where(above, low, middle), np.where(above, middle, high)
    with np.errstate(divide="ignore"):
        force: Floats = (high + SURELY) / size_per_n(prior, position_mm)
    return force


def smallest_forces(prior: Prior, threshold: float, supports_mm: Iterable[float]) -> SmallestForce:
    """Return the smallest force along the range of contacts; the supports within it are among the places.

    Between two places, 1 over the force is nearly straight: it falls to 0 at a support.
    """
    low, high = prior.position_mm
    within = [at for at in supports_mm if low <= at <= high]
    places = np.unique(np.concatenate([np.linspace(low, high, PLACES), within]))
    forces, most_n = smallest_force_n(prior, threshold, places).tolist(), BLIND * prior.force_n[1]
    return SmallestForce(position_mm=places.tolist(), force_n=[force if force <= most_n else None for force in forces])


def size_per_n(prior: Prior, position_mm: Floats) -> Floats:
    """Return the length of the whitened influence at positions (positions,), in deviations of a sample at rest per N.

    All channels work.
    """
    size: Floats = np.linalg.norm(shapes_at_rest(prior, position_mm), axis=1)
    return size
