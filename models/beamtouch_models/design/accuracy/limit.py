"""The accuracy limit: the mean position error that no estimator can beat, given the prior of a surface.

Place and force are drawn uniformly from their ranges, noise is added, and the posterior median along each axis
estimates the place: of all estimators it has the smallest mean absolute error along that axis. Limits that are compared
share their contacts.

*Estimators* are measured on simulated contacts, each with the other contacts that could have caused its sample. The
mean error over contacts and noise equals the mean over samples of the mean over each sample's posterior. The second
form has less scatter (Rao-Blackwell), and estimator and limit share what scatter is left.
"""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beamtouch_models.arrays import Bools, Floats
from beamtouch_models.design.accuracy.cell_posterior import Summaries, summarize
from beamtouch_models.design.accuracy.drawing import Draws, draw_evenly, even_contacts
from beamtouch_models.design.accuracy.posterior import CHUNK, posterior_quantiles
from beamtouch_models.design.accuracy.prior import Prior
from beamtouch_models.design.accuracy.statistics import Measurement, mean_of, ratio_of
from beamtouch_models.design.effort import USUAL, Effort
from beamtouch_models.design.sweeps import Fraction, TaskMap, in_turn, silent
from beamtouch_models.places import distances_mm

LIKELY = 16
"""Number of positions that represent a posterior, with equal probability each."""
CERTAIN, MORE = 0.01, 4
"""Relative standard error of a limit above which MORE times as many contacts are drawn."""
FAILED_DRAWS, LEAST_DRAWS = 1_024, 64
"""Usual and smallest number of contacts that the limits with each sensor failed share; only their ratios to the limit
are used."""
REPORTS = 20
"""Number of progress reports."""


@dataclass(frozen=True)
class ComparedLimit:
    """An accuracy limit beside another one, on the same contacts."""

    limit: Measurement
    """In percent of the diagonal."""
    ratio: Measurement
    """Over the other limit."""


def accuracy_limit(prior: Prior, draws: int, seed: int) -> Measurement:
    """Return the accuracy limit in percent of the diagonal, from at least `draws` simulated contacts.

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
    place, force, noise, weight = even_contacts(prior, draws, seed)
    errors = [
        _errors_percent(compared, compared.with_errors(place, force, noise), weight) for compared in (prior, *others)
    ]
    return [ComparedLimit(mean_of(error_percent), ratio_of(error_percent, errors[0])) for error_percent in errors[1:]]


def limits_without(prior: Prior, missing: Iterable[Sequence[int]], draws: int, seed: int) -> Iterator[ComparedLimit]:
    """Yield the limits without some channels beside that with all of them, as `compare_limits`.

    `missing` has the indices of the channels that each lacks.
    """
    drawn = draw_evenly(prior, draws, seed)
    errors_of_all = _errors_percent(prior, drawn.deflection_mm, drawn.weight)
    for lacking in missing:
        sample_mm = np.delete(drawn.deflection_mm, lacking, axis=1)
        errors = _errors_percent(prior.without(*lacking), sample_mm, drawn.weight)
        yield ComparedLimit(mean_of(errors), ratio_of(errors, errors_of_all))


def limits_with_one_failed(prior: Prior, limit: Measurement, seed: int, effort: Effort = USUAL) -> list[Measurement]:
    """Return the accuracy limits with each sensor failed, from that with all of them; none for a single sensor.

    All are in percent of the diagonal. Their ratios to the limit come from contacts that they share.
    """
    if prior.channels == 1:
        return []
    limits, draws = [], effort.of(FAILED_DRAWS, LEAST_DRAWS)
    for compared in limits_without(prior, [(index,) for index in range(prior.channels)], draws, seed):
        scatter = math.hypot(compared.ratio.standard_error * limit.value, compared.ratio.value * limit.standard_error)
        limits.append(Measurement(compared.ratio.value * limit.value, scatter))
    return limits


def _errors_percent(prior: Prior, deflection_mm: Floats, weight: Floats) -> Floats:
    """Return the weighted mean |error| of the posterior median of samples, (draws,) in percent of the diagonal."""
    errors: Floats = least_errors_mm(prior, deflection_mm) * weight / prior.diagonal_mm * 100
    return errors


def least_errors_mm(prior: Prior, deflection_mm: Floats) -> Floats:
    """Return the mean distance of each sample's posterior from its median, (draws,) in mm."""
    if prior.extent.axes == 1:
        return posterior_quantiles(prior, deflection_mm)[1]
    return summarize(prior, deflection_mm).distance_mm


def posterior_median_mm(prior: Prior, deflection_mm: Floats) -> Floats:
    """Return the posterior median of the position for each row of `deflection_mm` (draws, channels); (draws,) in mm.

    The noise must be positive.
    """
    return posterior_quantiles(prior, deflection_mm)[0][:, 0]


def posterior_places_mm(prior: Prior, deflection_mm: Floats) -> Floats:
    """Return the posterior medians along each axis, (draws, axes) in mm; arguments as `posterior_median_mm`."""
    if prior.extent.axes == 1:
        return posterior_median_mm(prior, deflection_mm)[:, None]
    return summarize(prior, deflection_mm).median_mm


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
    """(draws, LIKELY, axes) places that could have caused each sample; (draws, 1, axes), the true one, without noise.
    """
    median_mm: Floats
    """Posterior medians along each axis, (draws, axes)."""
    distance_mm: Floats
    """Mean distance of each posterior from its median (draws,)."""

    def error_mm(self, estimate_mm: NDArray[np.floating]) -> Floats:
        """|error| of estimates (draws, axes) for each likely place, (draws, LIKELY)."""
        return distances_mm(estimate_mm.astype(np.float64)[:, None] - self.likely_mm)

    def least_error_mm(self) -> Floats:
        """|error| of the posterior median, whose mean is the accuracy limit."""
        return self.error_mm(self.median_mm)

    def reached(self, estimate_mm: NDArray[np.floating]) -> Reached:
        """Return the mean |error| of estimates (draws, axes) over the posteriors of their samples, beside its limit.

        The value for the median is exact; the likely positions only give the difference of the estimate from it.
        """
        worse = (self.error_mm(estimate_mm) - self.least_error_mm()).mean(axis=1)
        error, limit, weight = self.distance_mm + worse, self.distance_mm, self.drawn.weight
        return Reached(mean_of(error, weight), mean_of(limit, weight), ratio_of(error * weight, limit * weight))

    def held(self, low_mm: NDArray[np.floating], high_mm: NDArray[np.floating]) -> Bools:
        """Return whether intervals (draws, axes) hold each likely place along each axis, (draws, LIKELY, axes)."""
        return (low_mm[:, None] <= self.likely_mm) & (self.likely_mm <= high_mm[:, None])


def simulated(prior: Prior, count: int, seed: int, progress: Fraction = silent, spread: TaskMap = in_turn) -> Contacts:
    """Draw at least `count` contacts of a prior, evenly, with the likely positions of their samples.

    The samples are tasks for `spread`, a part each.
    """
    drawn = draw_evenly(prior, count, seed)
    if prior.errors.noise_mm == 0:
        return Contacts(drawn, drawn.place_mm[:, None], drawn.place_mm, np.zeros(len(drawn.place_mm)))
    # With a random shift, averages over the likely positions are unbiased.
    shift = np.random.default_rng([seed, LIKELY]).uniform(size=(len(drawn.place_mm), 1))
    levels, posteriors = (np.arange(LIKELY) + shift) / LIKELY, []
    length = max(CHUNK, math.ceil(len(shift) / REPORTS))
    parts = [slice(start, start + length) for start in range(0, len(shift), length)]
    for posterior in spread(_summaries, [(prior, drawn.deflection_mm[part], levels[part]) for part in parts]):
        posteriors.append(posterior)
        progress(len(posteriors) / len(parts))
    likely, median, distance = (
        np.concatenate(values)
        for values in zip(*((one.likely_mm, one.median_mm, one.distance_mm) for one in posteriors), strict=True)
    )
    return Contacts(drawn, likely, median, distance)


def _summaries(task: tuple[Prior, Floats, Floats]) -> Summaries:
    """Return the posteriors of samples, with their places at levels."""
    prior, deflection_mm, levels = task
    if prior.extent.axes > 1:
        return summarize(prior, deflection_mm, levels)
    with_median = np.column_stack([np.full(len(levels), 0.5), levels])
    quantiles, distance = posterior_quantiles(prior, deflection_mm, with_median)
    return Summaries(quantiles[:, :1], distance, quantiles[:, 1:, None])


def simulate_until_certain(prior: Prior, count: int, seed: int) -> Contacts:
    """Like `simulated`, with MORE times the contacts if the accuracy limit would be uncertain otherwise."""
    contacts = simulated(prior, count, seed)
    limit = mean_of(contacts.distance_mm, contacts.drawn.weight)
    certain = limit.standard_error <= CERTAIN * limit.value
    return contacts if certain else simulated(prior, MORE * count, seed)
