"""Thresholds of touch: the log odds that a beam at rest exceeds at a stated rate, and the smallest force above them.

A whitened sample at rest is y = zero + noise, with unit variance in every direction if the zero were drawn anew for
each sample. But a zero is constant over days. So the rate is that of the noise, averaged over zeros that lie anywhere
within twice their drift, evenly. A contact at position x moves y along the unit vector u(x), so its log odds are
log(mean over x of exp(max(u(x) . y, 0)^2 / 2)): they depend on the directions only.

The probability that they exceed a threshold follows by importance sampling (Kahn & Marshall 1953,
doi 10.1287/opre.1.5.263): zero and noise are drawn about c u(x), with x spread evenly and c as large as the rate
demands. A sample with more noise than a settled one exceeds the threshold about as often, as its zero counts for less.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.special import ndtr, ndtri

from beamtouch_models.accuracy.prior import Prior
from beamtouch_models.accuracy.rest import exceeded_with, log_tilt, reach_of, tilted
from beamtouch_models.arrays import Floats
from beamtouch_models.detection import SURELY
from beamtouch_models.metadata import SmallestForce
from beamtouch_models.rates import MAX_FALSE, SECONDS_PER_DAY

PLACES = 129
"""Positions at which a contact is looked for; the odds change little between them."""
DRAWS = 4096
MAX_SETS = 40
"""Up to this many sets of channels of one size are all simulated; of more, an even choice."""
BETWEEN = np.log(2.0)
"""Largest excess of a set's threshold over that of its size, in nats: a factor of two in the rate."""
BLIND = 10.0
"""Where more than this many times the largest force is needed, nothing is seen: at a support, or right beside it."""
FLAT = 1e-9
"""Deflection over the largest one below which a place does not move: a support, where only rounding is left."""
MIN_NOISE = 1e-5
"""Smallest part of the noise in the error of a sample; below it, the zeros alone decide what rest exceeds."""
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


def touch_thresholds(prior: Prior, rate: float, seed: int) -> list[float]:
    """Return the log odds that rest exceeds with probability `rate` per sample, by the number of valid channels.

    Sets of the same size differ little. The threshold of a size lies where no set exceeds the rate twofold.
    """
    whole, noise = shapes_at_rest(prior), noise_at_rest(prior)
    found = []
    for size in range(1, prior.channels + 1):
        sets = list(combinations(range(prior.channels), size))
        chosen = sets[:: -(-len(sets) // MAX_SETS)]
        each = [touch_threshold(directions(whole[:, kept]), noise[list(kept)], rate, seed) for kept in chosen]
        found.append(max((max(each) + min(each)) / 2, max(each) - BETWEEN))
    return found


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


def touch_threshold(unit: Floats, noise: Floats, rate: float, seed: int) -> float:
    """Return the log odds that rest exceeds with probability `rate`; `unit` and `noise` as above."""
    rest = rest_like_contact(unit, noise, rate, DRAWS, seed)
    odds = log_odds(unit, rest.sample)
    order = np.argsort(-odds)
    exceeded = np.cumsum(rest.weight[order]) / DRAWS
    return float(odds[order][min(int(np.searchsorted(exceeded, rate)), DRAWS - 1)])


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
