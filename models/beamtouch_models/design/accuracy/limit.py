"""The accuracy limit: the mean position error that no estimator can beat, given the prior of a surface.

Position and force are drawn uniformly from their ranges, noise is added, and the posterior median estimates the
position: of all estimators it has the smallest mean absolute error. Limits that are compared share their contacts.

*Cramer-Rao.* The standard deviation of an unbiased estimate is at least one over the root of the Fisher information.
For a sample of mean F g(x) with independent Gaussian errors s per channel, the information is |F g'(x) / s|^2 if the
force is known. If the force is open, only the part of g'/s orthogonal to g/s counts: a change along g may as well come
from the force. The errors are those of noise, gains, zeros and mounting. Their size depends on the contact; the bound
ignores that. Kay, Fundamentals of Statistical Signal Processing: Estimation Theory, 1993, sec. 3.7 and 3.8.

*Estimators* are measured on simulated contacts, each with the other contacts that could have caused its sample. The
mean error over contacts and noise equals the mean over samples of the mean over each sample's posterior. The second
form has less scatter (Rao-Blackwell), and estimator and limit share what scatter is left.
"""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtri

from beamtouch_models.arrays import Bools, Floats
from beamtouch_models.design.accuracy.posterior import CHUNK, posterior_quantiles
from beamtouch_models.design.accuracy.prior import Prior
from beamtouch_models.design.accuracy.statistics import SCRAMBLINGS, Measurement, mean_of, ratio_of
from beamtouch_models.design.effort import USUAL, Effort
from beamtouch_models.design.sweeps import Fraction, TaskMap, in_turn, silent

POSITIONS, FORCES = 1001, 32
"""Points of the midpoint rule over the ranges."""
UNIFORM = 0.5
"""Share of evenly spread contacts that are drawn uniformly; the largest weight is about one over it."""
LIKELY = 16
"""Number of positions that represent a posterior, with equal probability each."""
CERTAIN, MORE = 0.01, 4
"""Relative standard error of a limit above which MORE times as many contacts are drawn."""
FAILED_DRAWS, LEAST_DRAWS = 1_024, 64
"""Usual and smallest number of contacts that the limits with each sensor failed share; only their ratios to the limit
are used."""
REPORTS = 20
"""Number of progress reports."""


def cramer_rao_deviation_mm(prior: Prior, position_mm: ArrayLike, force_n: ArrayLike) -> Floats:
    """Return the Cramer-Rao bound on the deviation of position at contacts (contacts,), in mm; may be infinite.

    It holds for unbiased estimates. Where it exceeds the range, as at a support, an estimate that uses the range is
    better.
    """
    position, force = np.broadcast_arrays(np.asarray(position_mm, np.float64), np.asarray(force_n, np.float64))
    deviation = prior.deviation_in_table_mm(position, force[:, None])
    slope, shape = prior.table.derivative()(position) / deviation, prior.table(position) / deviation
    if not prior.force_is_known:
        size = (shape**2).sum(axis=1, keepdims=True)
        along = (slope * shape).sum(axis=1, keepdims=True)
        slope = slope - shape * np.divide(along, size, out=np.zeros_like(size), where=size > 0)
    with np.errstate(divide="ignore"):
        bound: Floats = 1 / (force * np.linalg.norm(slope, axis=1))
    return bound


def cramer_rao_error_mm(prior: Prior) -> float:
    """Return the mean |error| over the ranges of a Gaussian error with the bound's deviation, at most that of a guess.

    It approaches the accuracy limit as the noise goes to zero. At high noise it is a rough value and not a bound.
    """
    return float(cramer_rao_errors_mm(prior).mean())


def cramer_rao_errors_mm(prior: Prior) -> Floats:
    """The same over the forces alone, in the middle of POSITIONS equal parts of the range of positions."""
    low, high = prior.position_mm
    positions = low + (high - low) * (np.arange(POSITIONS) + 0.5) / POSITIONS
    weak, strong = prior.force_n
    forces = weak + (strong - weak) * (np.arange(FORCES) + 0.5) / FORCES if weak < strong else np.array([weak])
    every, each = np.repeat(positions, len(forces)), np.tile(forces, POSITIONS)
    gaussian = np.sqrt(2 / np.pi) * cramer_rao_deviation_mm(prior, every, each).reshape(POSITIONS, -1)
    guess = ((positions - low) ** 2 + (high - positions) ** 2) / (2 * (high - low))
    errors: Floats = np.minimum(gaussian, guess[:, None]).mean(axis=1)
    return errors


@dataclass(frozen=True)
class Draws:
    """Simulated contacts with their samples."""

    position_mm: Floats
    force_n: Floats
    deflection_mm: Floats
    """(draws, sensors), with noise."""
    weight: Floats
    """(draws,), weight of each contact in an average; 1 on average."""


def draw(prior: Prior, count: int, seed: int) -> Draws:
    """Draw contacts uniformly from the ranges; noise, gains and zeros are Gaussian, drawn per sample and channel."""
    rng = np.random.default_rng(seed)
    position = rng.uniform(*prior.position_mm, size=count)
    force = rng.uniform(*prior.force_n, size=count)
    return Draws(position, force, prior.draw(position, force, rng), np.ones(count))


def draw_evenly(prior: Prior, count: int, seed: int) -> Draws:
    """Draw at least `count` contacts like `draw`, but spread evenly over their distribution.

    They come in SCRAMBLINGS consecutive parts of equal length. The parts are independent, so the scatter of their
    means gives a standard error. Half of the contacts are drawn where the Cramer-Rao bound is large, for example next
    to a support, with smaller weights; otherwise a few contacts would dominate a mean.
    """
    position, force, noise, weight = _even_contacts(prior, count, seed)
    clean, deviation = prior.sampled(position, force)
    return Draws(position, force, clean + deviation * noise, weight)


def _even_contacts(prior: Prior, count: int, seed: int) -> tuple[Floats, Floats, Floats, Floats]:
    """Return positions, forces, noise of variance 1 (draws, channels), and weights of the contacts of `draw_evenly`."""
    rngs = np.random.default_rng(seed).spawn(SCRAMBLINGS)
    each = 2 ** max(0, int(np.ceil(np.log2(count / SCRAMBLINGS))))
    contacts = [spread_contacts(prior, each, rng) for rng in rngs]
    position, force, noise = (np.concatenate(parts) for parts in zip(*contacts, strict=True))
    position, weight = concentrate_on_errors(prior, position)
    return position, force, noise, weight / weight.mean()


def spread_contacts(prior: Prior, draws: int, rng: np.random.Generator) -> tuple[Floats, Floats, Floats]:
    """Return contacts and noise spread evenly over their distributions; `draws` is a power of two.

    Returns
    -------
    positions in mm (draws,), forces in N (draws,), and noise of variance 1 (draws, channels).
    """
    from scipy.stats.qmc import Sobol  # noqa: PLC0415  # slow to import, and many commands do not need it

    # Keep points off 0 and 1, where the noise would be infinite.
    points = np.clip(Sobol(prior.channels + 2, rng=rng).random(draws), 2.0**-32, 1 - 2.0**-32)
    low, high = prior.position_mm
    weak, strong = prior.force_n
    return low + (high - low) * points[:, 0], weak + (strong - weak) * points[:, 1], ndtri(points[:, 2:])


def concentrate_on_errors(prior: Prior, position_mm: Floats) -> tuple[Floats, Floats]:
    """Concentrate evenly spread positions where errors are large.

    Returns positions in mm and weights, both (draws,).
    """
    if prior.noise_mm == 0:
        return position_mm, np.ones(len(position_mm))
    error_mm = cramer_rao_errors_mm(prior)
    often = UNIFORM + (1 - UNIFORM) * error_mm / error_mm.mean()
    low, high = prior.position_mm
    before = np.concatenate([[0.0], np.cumsum(often)]) / len(often)
    edges = np.linspace(low, high, len(before))
    moved = np.interp((position_mm - low) / (high - low) * before[-1], before, edges)
    cell = np.clip(np.searchsorted(edges, moved, side="right") - 1, 0, len(often) - 1)
    return moved, 1 / often[cell]


@dataclass(frozen=True)
class ComparedLimit:
    """An accuracy limit beside another one, on the same contacts."""

    limit: Measurement
    """In percent of the length."""
    ratio: Measurement
    """Over the other limit."""


def accuracy_limit(prior: Prior, draws: int, seed: int) -> Measurement:
    """Return the accuracy limit in percent of the length, from at least `draws` simulated contacts.

    The mean is that of eq. 5 of the paper, with less scatter: each sample counts with the mean |error| over its
    posterior instead of the one drawn error, and contacts and noise are spread evenly (scrambled Sobol points; Owen
    1997, doi 10.1214/aos/1031594731). The standard error comes from the scatter of independent scramblings. The noise
    must be positive.
    """
    drawn = draw_evenly(prior, draws, seed)
    return mean_of(_errors_percent(prior, drawn.deflection_mm, drawn.weight))


def compare_limits(prior: Prior, others: Sequence[Prior], draws: int, seed: int) -> list[ComparedLimit]:
    """Return the limits of other priors with the same ranges and channels beside that of a prior.

    All share at least `draws` contacts with their noise, so that their ratios scatter far less than the limits do.
    """
    position, force, noise, weight = _even_contacts(prior, draws, seed)
    errors = []
    for one in (prior, *others):
        clean, deviation = one.sampled(position, force)
        errors.append(_errors_percent(one, clean + deviation * noise, weight))
    return [ComparedLimit(mean_of(other), ratio_of(other, errors[0])) for other in errors[1:]]


def limits_without(prior: Prior, missing: Iterable[Sequence[int]], draws: int, seed: int) -> Iterator[ComparedLimit]:
    """Yield the limits without some channels beside that with all of them, as `compare_limits`.

    `missing` has the indices of the channels that each lacks.
    """
    drawn = draw_evenly(prior, draws, seed)
    whole = _errors_percent(prior, drawn.deflection_mm, drawn.weight)
    for lacking in missing:
        sample_mm = np.delete(drawn.deflection_mm, lacking, axis=1)
        errors = _errors_percent(prior.without(*lacking), sample_mm, drawn.weight)
        yield ComparedLimit(mean_of(errors), ratio_of(errors, whole))


def limits_with_one_failed(prior: Prior, limit: Measurement, seed: int, effort: Effort = USUAL) -> list[Measurement]:
    """Return the accuracy limits with each sensor failed, from that with all of them; none for a single sensor.

    All are in percent of the length. Their ratios to the limit come from contacts that they share.
    """
    if prior.channels == 1:
        return []
    found, draws = [], effort.of(FAILED_DRAWS, LEAST_DRAWS)
    for one in limits_without(prior, [(index,) for index in range(prior.channels)], draws, seed):
        scatter = math.hypot(one.ratio.standard_error * limit.value, one.ratio.value * limit.standard_error)
        found.append(Measurement(one.ratio.value * limit.value, scatter))
    return found


def _errors_percent(prior: Prior, deflection_mm: Floats, weight: Floats) -> Floats:
    """Return the weighted mean |error| of the posterior median of samples, (draws,) in percent of the length."""
    errors: Floats = posterior_quantiles(prior, deflection_mm)[1] * weight / prior.length_mm * 100
    return errors


def posterior_median_mm(prior: Prior, deflection_mm: Floats) -> Floats:
    """Return the posterior median of the position for each row of `deflection_mm` (draws, channels); (draws,) in mm.

    The noise must be positive.
    """
    return posterior_quantiles(prior, deflection_mm)[0][:, 0]


@dataclass(frozen=True)
class Reached:
    """The mean error of estimates beside its limit, in mm, on the same contacts."""

    error_mm: Measurement
    limit_mm: Measurement
    ratio: Measurement


@dataclass(frozen=True)
class Contacts:
    """Contacts and their samples, evenly spread, in the parts that `statistics` expects."""

    drawn: Draws
    likely_mm: Floats
    """(draws, LIKELY) positions that could have caused each sample; (draws, 1), the true one, without noise."""
    median_mm: Floats
    """Posterior medians (draws,)."""
    deviation_mm: Floats
    """Mean distance of each posterior from its median (draws,)."""

    def error_mm(self, estimate_mm: NDArray[np.floating]) -> Floats:
        """|error| of estimates (draws,) for each likely position, in the shape of `likely_mm`."""
        return np.abs(estimate_mm.astype(np.float64)[:, None] - self.likely_mm)

    def least_error_mm(self) -> Floats:
        """|error| of the posterior median, whose mean is the accuracy limit."""
        return self.error_mm(self.median_mm)

    def reached(self, estimate_mm: NDArray[np.floating]) -> Reached:
        """Return the mean |error| of estimates (draws,) over the posteriors of their samples, beside its limit.

        The value for the median is exact; the likely positions only give the difference of the estimate from it.
        """
        worse = (self.error_mm(estimate_mm) - self.least_error_mm()).mean(axis=1)
        error, limit, weight = self.deviation_mm + worse, self.deviation_mm, self.drawn.weight
        return Reached(mean_of(error, weight), mean_of(limit, weight), ratio_of(error * weight, limit * weight))

    def held(self, low_mm: NDArray[np.floating], high_mm: NDArray[np.floating]) -> Bools:
        """Return whether intervals (draws,) hold each likely position, in the shape of `likely_mm`."""
        return (low_mm[:, None] <= self.likely_mm) & (self.likely_mm <= high_mm[:, None])


def simulated(prior: Prior, count: int, seed: int, progress: Fraction = silent, spread: TaskMap = in_turn) -> Contacts:
    """Draw at least `count` contacts of a prior, evenly, with the likely positions of their samples.

    The samples are tasks for `spread`, a part each.
    """
    drawn = draw_evenly(prior, count, seed)
    if prior.noise_mm == 0:
        return Contacts(drawn, drawn.position_mm[:, None], drawn.position_mm, np.zeros(len(drawn.position_mm)))
    # With a random shift, averages over the likely positions are unbiased.
    shift = np.random.default_rng([seed, LIKELY]).uniform(size=(len(drawn.position_mm), 1))
    levels = np.column_stack([np.full(len(shift), 0.5), (np.arange(LIKELY) + shift) / LIKELY])
    found = []
    length = CHUNK * max(1, -(-len(shift) // (CHUNK * REPORTS)))
    parts = [slice(start, start + length) for start in range(0, len(shift), length)]
    for quantiles in spread(_quantiles, [(prior, drawn.deflection_mm[part], levels[part]) for part in parts]):
        found.append(quantiles)
        progress(len(found) / len(parts))
    whole = np.concatenate(found)
    return Contacts(drawn, whole[:, 1:-1], whole[:, 0], whole[:, -1])


def _quantiles(task: tuple[Prior, Floats, Floats]) -> Floats:
    """Return quantiles (samples, levels) of the posteriors of samples, with the mean distances as the last column."""
    prior, deflection_mm, levels = task
    return np.column_stack(posterior_quantiles(prior, deflection_mm, levels))


def simulate_until_certain(prior: Prior, count: int, seed: int) -> Contacts:
    """Like `simulated`, with MORE times the contacts if the accuracy limit would be uncertain otherwise."""
    contacts = simulated(prior, count, seed)
    limit = mean_of(contacts.deviation_mm, contacts.drawn.weight)
    certain = limit.standard_error <= CERTAIN * limit.value
    return contacts if certain else simulated(prior, MORE * count, seed)
