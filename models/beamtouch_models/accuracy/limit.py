"""The accuracy limit: the mean position error that no estimator can beat, given the prior of a surface.

Position and force are drawn uniformly from their ranges, noise is added, and the posterior median estimates the
position: of all estimators it has the smallest mean absolute error. Limits that are compared share their contacts.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri

from beamtouch_models.accuracy import cramer_rao
from beamtouch_models.accuracy.posterior import posterior_quantiles
from beamtouch_models.accuracy.prior import Prior
from beamtouch_models.accuracy.statistics import SCRAMBLINGS, Measurement, mean_of, ratio_of
from beamtouch_models.arrays import Floats
from beamtouch_models.errors import SceneError

UNIFORM = 0.5
"""Share of evenly spread contacts that are drawn uniformly; the largest weight is about one over it."""


@dataclass(frozen=True)
class Draws:
    """Simulated contacts with their readings."""

    position_mm: Floats
    force_n: Floats
    deflection_mm: Floats
    """(draws, sensors), with noise."""
    weight: Floats
    """(draws,), weight of each contact in an average; 1 on average."""


@dataclass(frozen=True)
class MeanError:
    """Mean |position error| in percent of the length, and its standard error."""

    percent: float
    standard_error: float


@dataclass(frozen=True)
class ComparedLimit:
    """An accuracy limit beside another one, on the same contacts."""

    limit: MeanError
    ratio: Measurement
    """Over the other limit."""


def draw(prior: Prior, count: int, seed: int) -> Draws:
    """Draw contacts uniformly from the ranges; noise, gains and zeros are Gaussian, drawn per sample and channel."""
    rng = np.random.default_rng(seed)
    position = rng.uniform(*prior.position_mm, size=count)
    force = rng.uniform(*prior.force_n, size=count)
    clean, deviation = prior.sampled(position, force)
    return Draws(position, force, clean + rng.normal(size=clean.shape) * deviation, np.ones(count))


def accuracy_limit(prior: Prior, draws: int, seed: int) -> MeanError:
    """Return the accuracy limit, from at least `draws` simulated contacts.

    The mean is that of eq. 5 of the paper, with less scatter: each reading counts with the mean |error| over its
    posterior instead of the one drawn error, and contacts and noise are spread evenly (scrambled Sobol points; Owen
    1997, doi 10.1214/aos/1031594731). The standard error comes from the scatter of independent scramblings.

    Raises
    ------
    SceneError
        The noise is 0, so that there is no limit.
    """
    _require_noise(prior)
    drawn = draw_evenly(prior, draws, seed)
    return _limit_of(_errors_percent(prior, drawn.deflection_mm, drawn.weight))


def compare_limits(prior: Prior, others: Sequence[Prior], draws: int, seed: int) -> list[ComparedLimit]:
    """Return the limits of other priors with the same ranges and channels beside that of a prior.

    All share at least `draws` contacts with their noise, so that their ratios scatter far less than the limits do.
    Errors are those of `accuracy_limit`.
    """
    _require_noise(prior)
    position, force, noise, weight = _even_contacts(prior, draws, seed)
    errors = []
    for one in (prior, *others):
        clean, deviation = one.sampled(position, force)
        errors.append(_errors_percent(one, clean + deviation * noise, weight))
    return [ComparedLimit(_limit_of(other), ratio_of(other, errors[0])) for other in errors[1:]]


def limits_without(prior: Prior, missing: Iterable[Sequence[int]], draws: int, seed: int) -> Iterator[ComparedLimit]:
    """Yield the limits without some channels beside that with all of them, as `compare_limits`.

    `missing` has the indices of the channels that each lacks.
    """
    _require_noise(prior)
    drawn = draw_evenly(prior, draws, seed)
    whole = _errors_percent(prior, drawn.deflection_mm, drawn.weight)
    for lacking in missing:
        sample_mm = np.delete(drawn.deflection_mm, lacking, axis=1)
        errors = _errors_percent(prior.without(*lacking), sample_mm, drawn.weight)
        yield ComparedLimit(_limit_of(errors), ratio_of(errors, whole))


def _require_noise(prior: Prior) -> None:
    if not 0 < prior.noise_mm < np.inf:
        message = (
            f"sensors: with a noise of {prior.noise_mm:g} mm there is no accuracy limit; state the noise of a reading"
        )
        raise SceneError(message)


def _errors_percent(prior: Prior, deflection_mm: Floats, weight: Floats) -> Floats:
    """Return the weighted mean |error| of the posterior median of samples, (draws,) in percent of the length."""
    errors: Floats = posterior_quantiles(prior, deflection_mm)[1] * weight / prior.length_mm * 100
    return errors


def _limit_of(errors_percent: Floats) -> MeanError:
    mean = mean_of(errors_percent)
    return MeanError(mean.value, mean.standard_error)


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
    position, weight = where_it_errs(prior, position)
    return position, force, noise, weight / weight.mean()


def where_it_errs(prior: Prior, position_mm: Floats) -> tuple[Floats, Floats]:
    """Concentrate evenly spread positions where errors are large.

    Returns positions in mm and weights, both (draws,).
    """
    if prior.noise_mm == 0:
        return position_mm, np.ones(len(position_mm))
    error_mm = cramer_rao.mean_errors_mm(prior)
    often = UNIFORM + (1 - UNIFORM) * error_mm / error_mm.mean()
    low, high = prior.position_mm
    before = np.concatenate([[0.0], np.cumsum(often)]) / len(often)
    edges = np.linspace(low, high, len(before))
    moved = np.interp((position_mm - low) / (high - low) * before[-1], before, edges)
    cell = np.clip(np.searchsorted(edges, moved, side="right") - 1, 0, len(often) - 1)
    return moved, 1 / often[cell]


def spread_contacts(prior: Prior, draws: int, rng: np.random.Generator) -> tuple[Floats, Floats, Floats]:
    """Return contacts and noise spread evenly over their distributions; `draws` is a power of two.

    Returns
    -------
    positions in mm (draws,), forces in N (draws,), and noise of variance 1 (draws, channels).
    """
    points = _spread(prior.channels + 2, draws, rng)
    low, high = prior.position_mm
    weak, strong = prior.force_n
    return low + (high - low) * points[:, 0], weak + (strong - weak) * points[:, 1], ndtri(points[:, 2:])


def _spread(dimensions: int, draws: int, rng: np.random.Generator) -> Floats:
    from scipy.stats.qmc import Sobol  # noqa: PLC0415  # slow to import, and many commands do not need it

    # Keep points off 0 and 1, where the noise would be infinite.
    points: Floats = np.clip(Sobol(dimensions, rng=rng).random(draws), 2.0**-32, 1 - 2.0**-32)
    return points


def posterior_median_mm(prior: Prior, deflection_mm: Floats) -> Floats:
    """Return the posterior median of the position for each row of `deflection_mm` (draws, channels); (draws,) in mm.

    The noise must be positive.
    """
    return posterior_quantiles(prior, deflection_mm)[0][:, 0]
