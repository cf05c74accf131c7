"""Thresholds of touch, of rest and of the misfit, and the smallest force above that of touch. No draws.

A whitened sample at rest is y = zero + noise, with unit variance in every direction if the zero were drawn anew for
each sample. But a zero is constant over days. So a rate is that of the noise, averaged over zeros that lie anywhere
within twice their drift, evenly. All thresholds follow from the height that the sum of zero and noise exceeds along a
direction, at such a rate (`height_exceeded`).

*Touch.* A contact at position x moves y along the unit vector u(x), so its log odds are
log(mean over x of exp(max(u(x) . y, 0)^2 / 2)): they depend on the directions only. The odds exceed T about as often as
u(x) . y exceeds sqrt(2 T), on average over x. For noise alone this is exact up to a share of 1 / T, whatever the path
of u: a longer path comes near more samples, and a smaller part of it lies near each (the tube around a path, Hotelling
1939, doi 10.2307/2371512, times the width of the peak by Laplace's method). Zeros are bounded, so that the odds exceed
T more rarely than that. A sample with more noise than a settled one exceeds it about as often, as its zero counts for
less.

*Rest and misfit.* The sum of the squares of y says whether rest explains a sample, the misfit whether a contact does,
which fits two directions of the errors: its own, and that of its change with the position. The first of these it fits
by its force, of which a stated range that is not open leaves less: the errors along it add at most l chi-square of one
degree (`ForceRange.checked`). A chi-square of l more degrees exceeds that at any rate at which a sample is odd. So of
two channels an open force leaves no direction. But contacts of two channels lie within a cone, between the directions
of the contacts at either end of the range. A contact at the edge of the cone leaves the errors on one side of it, half
of those of one direction. A contact in a narrow cone leaves those on both sides, which are at most those of one
direction. So one direction is the bound. The gain error of a load counts like a zero, because it stays as long as the
load does.

A stretch begins with three odd samples in a row, which share most of their readings. To raise three means of n readings
alike takes n / (n - 1) times the squares that raise one. So what they have in common is noise of that smaller variance,
and they are odd together as often as one sample is, to that power. Simulated thresholds lie 1 to 10 % lower in
deviations, as an odd stretch of many samples is one.
"""

from collections.abc import Iterable
from functools import cache

import numpy as np
from scipy.optimize.elementwise import find_root
from scipy.special import chdtri, log_ndtr, logsumexp, ndtr, ndtri

from beamtouch_models.arrays import Floats, Indices
from beamtouch_models.design.accuracy.prior import Prior
from beamtouch_models.design.rates import MAX_FALSE, SECONDS_PER_DAY
from beamtouch_models.places import on_axis
from beamtouch_models.runtime.decision.decider import PERSISTENCE
from beamtouch_models.runtime.metadata_parts import FilterChoice, SmallestForce

PLACES = 129
"""Places at which a contact is looked for, about; the odds change little between them."""
BLIND = 10.0
"""A place that needs more than this many times the largest force shows nothing: a support, or right beside one."""
FLAT = 1e-9
"""Deflection over the largest one below which a place does not move: a support, where only rounding is left."""
DRIFTS = 2.0
"""Farthest a zero lies, in its drifts."""
SURELY = 1.645
"""Deviations of a sample that a force must exceed the threshold by, so that 95 % of the samples do."""
MIN_NOISE = 1e-5
"""Smallest part of the noise in the error of a sample; below it, the zeros alone decide what rest exceeds."""
MIN_EXPONENT = 1e-6
"""Smallest exponent of a tilt; below it a tilt makes no difference."""
DIRECTIONS = 512
"""Directions of the errors for a threshold of rest or of the misfit."""
PER_DAY = 1.0
"""False stretches per day of rest."""
PER_DAY_OF_CONTACT = 0.5
"""False stretches per day of a contact, half of those at rest: weak contacts and contacts near an end of the range fit
fewer than two directions of the errors, which makes up to three times as many stretches."""
MAX_ALIKE = 24
"""Readings in a growing mean that make false stretches about as frequent as they become: successive samples share most
of their readings, and stretches still begin often."""
APART = 64
"""Readings in a mean from which on false stretches are as frequent per mean instead of per reading."""
MAX_RATE_PER_SAMPLE = 0.01
"""Largest rate per sample; above it, a misfit no longer tells anything."""


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
    shapes, noise, every = shapes_at_rest(prior), noise_at_rest(prior), np.arange(prior.channels)
    sets = [[np.roll(every, -first)[:size] for first in every] for size in every + 1]
    return [
        max(touch_threshold(directions(shapes[:, working]), noise[working], rate) for working in same_size)
        for same_size in sets
    ]


def touch_threshold(unit: Floats, noise: Floats, rate: float) -> float:
    """Return the log odds that rest exceeds with probability `rate`.

    `unit` are directions (places, channels), `noise` the deviations of the noise (channels,). A place that does not
    move looks like rest, and counts for nothing.
    """
    unit = unit[unit.any(axis=1)]
    return height_exceeded(unit, noise, noise, rate) ** 2 / 2 if len(unit) else 0.0


def unexplained_thresholds(prior: Prior, rate_hz: float, readings: int) -> tuple[list[float], list[float]]:
    """Return the thresholds of rest and of misfit, by the number of valid channels, for means of that many readings.

    Sets of channels of one size hardly differ. A sample is odd if it exceeds both; that of rest is chosen as if it were
    alone, so that false stretches are rarer than stated.
    """
    noise = float(np.sqrt(np.mean(noise_at_rest(prior) ** 2)))
    sizes = range(1, prior.channels + 1)
    misfit = [misfit_threshold(noise, size, prior.force_range.checked, rate_hz, readings) for size in sizes]
    rest = [_threshold_of_squares(noise, size, size, PER_DAY / rate_hz, readings) for size in sizes]
    return np.maximum(rest, misfit).tolist(), misfit


@cache
def misfit_threshold(noise: float, channels: int, checked: float, rate_hz: float, readings: int) -> float:
    """Return the threshold of the misfit of one contact, for means of `readings` readings of this many channels.

    `noise` is the part of the noise in the deviation of a sample; the rest of its unit variance is the zero. `checked`
    is that of the stated range of the force.
    """
    free = left_by_contact(channels, checked)
    return _threshold_of_squares(noise, channels, free, PER_DAY_OF_CONTACT / rate_hz, readings)


def left_by_contact(channels: int, checked: float) -> float:
    """Return the number of directions of the errors that a contact leaves unexplained at most.

    Of its force, it leaves the part `checked` of a direction.
    """
    return max(1.0, channels - 2 + checked)


def readings_alike(chosen: FilterChoice) -> int:
    """Return the number of readings in the means of a filter that make the most false stretches."""
    return max(chosen.window, min(chosen.max_readings, MAX_ALIKE))


def _threshold_of_squares(noise: float, channels: int, free: float, per_day_hz: float, readings: int) -> float:
    """Return the sum of squares in `free` directions that begins false stretches at a rate per day and reading."""
    rate = min(per_day_hz * max(1.0, readings / APART) / SECONDS_PER_DAY, MAX_RATE_PER_SAMPLE)
    # Squares that raise as many means as make a stretch alike, over those that raise one. Single readings, which share
    # nothing, are odd together less often than means of two.
    shared = 2 * max(readings, 2)
    squares = shared / (shared - PERSISTENCE + 1)
    rate_per_direction = float(ndtr(-np.sqrt(squares * chdtri(free, rate ** (1 / squares)))))
    unit = np.random.default_rng(channels).normal(size=(DIRECTIONS, channels))
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    deviation = np.full(channels, noise)
    return height_exceeded(unit, deviation, deviation / np.sqrt(squares), rate_per_direction) ** 2


def height_exceeded(unit: Floats, whole: Floats, noise: Floats, rate: float) -> float:
    """Return the height that zero and noise exceed with probability `rate` along directions, on average over them.

    `unit` are directions (places, channels), `whole` the deviations of the noise of a sample (channels,), whose zeros
    are the rest of a unit variance, and `noise` those of the part of the noise that counts.
    """
    reach = DRIFTS * np.sqrt(np.maximum(1 - whole**2, 0.0))
    heights, tilts = exceeded_with(rate, np.abs(unit) * reach, np.linalg.norm(unit * noise, axis=1))
    # Beyond the heights, tails fall exponentially.
    return float(logsumexp(tilts.mean() * heights, b=1 / len(heights)) / tilts.mean())


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

    def beyond(tilt: Floats, one: Indices) -> Floats:
        return _saddlepoint(tilt, reach[one], noise[one])[1] - float(np.log(rate))

    # The noise alone needs half of the largest tilt.
    tilt: Floats = find_root(beyond, (0.0, -2 * ndtri(rate) / noise), args=(np.arange(len(noise)),)).x
    return _saddlepoint(tilt, reach, noise)[0], tilt


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


def shapes_at_rest(prior: Prior, place_mm: Floats | None = None) -> Floats:
    """Return the influence over the errors of a sample at rest, (places, channels) per newton.

    It is that at PLACES over the extent, from the table, or at places (places, axes).
    """
    matrix = prior.influence_table(prior.extent.grid(PLACES)) if place_mm is None else prior.influence_at(place_mm)
    shapes: Floats = matrix / prior.rest_mm
    return shapes


def noise_at_rest(prior: Prior) -> Floats:
    """Return the deviation (channels,) of the noise of a whitened sample; the rest of its unit variance is the zero."""
    share: Floats = np.maximum(prior.errors.noise_mm / prior.rest_mm, MIN_NOISE)
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


def smallest_force_n(prior: Prior, threshold: float, place_mm: Floats) -> Floats:
    """Return the force at places (places, axes) of which 95 % of settled samples are a contact; all channels work.

    It is infinite where no sensor moves.
    """
    unit, along = directions(shapes_at_rest(prior)), directions(shapes_at_rest(prior, place_mm))

    def above(size: Floats, place: Indices) -> Floats:
        return log_odds(unit, size[:, None] * along[place]) - threshold

    most = 2 * np.sqrt(2 * threshold) + 8
    root = find_root(above, (0.0, most), args=(np.arange(len(along)),))
    with np.errstate(divide="ignore"):
        force: Floats = (np.where(root.success, root.x, most) + SURELY) / size_per_n(prior, place_mm)
    return force


def smallest_forces(prior: Prior, threshold: float, supports_mm: Iterable[float]) -> SmallestForce:
    """Return the smallest force along a beam's range of contacts; the supports within it are among the places.

    Between two places, 1 over the force is nearly straight: it falls to 0 at a support. On a plate the places are a
    grid.
    """
    most_n = BLIND * prior.force_n[1]
    if prior.extent.axes > 1:
        places = prior.extent.grid(PLACES)
        seen = [force if force <= most_n else None for force in smallest_force_n(prior, threshold, places).tolist()]
        return SmallestForce(position_mm=places[:, 0].tolist(), across_mm=places[:, 1].tolist(), force_n=seen)
    low, high = prior.extent.range_mm
    within = [support for support in supports_mm if low <= support <= high]
    positions = np.unique(np.concatenate([np.linspace(low, high, PLACES), within]))
    forces = smallest_force_n(prior, threshold, on_axis(positions)).tolist()
    return SmallestForce(
        position_mm=positions.tolist(), force_n=[force if force <= most_n else None for force in forces]
    )


def size_per_n(prior: Prior, place_mm: Floats) -> Floats:
    """Return the length of the whitened influence at places (places, axes), in deviations of a sample at rest per N.

    All channels work.
    """
    size: Floats = np.linalg.norm(shapes_at_rest(prior, place_mm), axis=1)
    return size
