"""The accuracy limit: the mean position error that no estimator can beat, given the prior of a surface.

Position and force are drawn uniformly from their ranges, noise is added, and the posterior median estimates the
position: of all estimators it has the smallest mean absolute error. The force is integrated out exactly: for a given
position the likelihood is Gaussian in the force, so its integral over the range is a difference of normal
distribution functions.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import log_ndtr, ndtri

from beamtouch_models.accuracy import cramer_rao
from beamtouch_models.accuracy.densities import densities
from beamtouch_models.accuracy.prior import Prior
from beamtouch_models.arrays import Bools, Floats
from beamtouch_models.errors import SceneError

GRID = 801
"""Positions over the whole range."""
FINE_GRID = 129
ROUNDS = 12
NEGLIGIBLE = 40.0
"""Difference to the largest log density beyond which a position is not part of a posterior."""
CHUNK = 200
SCRAMBLINGS = 16
UNIFORM = 0.5
"""Share of evenly spread contacts that are drawn uniformly; the largest weight is one over it."""
MIN_NOISE = 1e-12
"""Smallest noise of a sample over the largest deflection: below it, rounding in float64 shows in the posterior."""


@dataclass(frozen=True)
class Draws:
    """Simulated contacts with their readings."""

    position_mm: Floats
    force_n: Floats
    deflection_mm: Floats
    """(draws, sensors), with noise."""
    weight: Floats | float = 1.0
    """(draws,), weight of each contact in an average; 1 on average."""


@dataclass(frozen=True)
class MeanError:
    """Mean |position error| in percent of the length, and its standard error."""

    percent: float
    standard_error: float


def draw(prior: Prior, count: int, seed: int) -> Draws:
    """Draw contacts uniformly from the ranges, with Gaussian noise per channel."""
    rng = np.random.default_rng(seed)
    position = rng.uniform(*prior.position_mm, size=count)
    force = rng.uniform(*prior.force_n, size=count)
    clean = force[:, None] * prior.influence_at(position)
    return Draws(position, force, clean + rng.normal(scale=prior.noise_mm, size=clean.shape))


def mean_error(prior: Prior, draws: Draws, estimate_mm: Floats) -> MeanError:
    """Eq. 5 of the paper over all draws."""
    return _mean_of(np.abs(estimate_mm - draws.position_mm) / prior.length_mm * 100)


def _mean_of(percent: Floats) -> MeanError:
    """Mean of errors in percent of the length, with its standard error from their scatter."""
    return MeanError(float(percent.mean()), float(percent.std(ddof=1) / np.sqrt(len(percent))))


def accuracy_limit(prior: Prior, draws: int, seed: int) -> MeanError:
    """Return the accuracy limit, from at least `draws` simulated contacts.

    The mean is that of `mean_error`, with less scatter: each reading counts with the mean |error| over its posterior
    instead of the one drawn error, and contacts and noise are spread evenly (scrambled Sobol points; Owen 1997,
    doi 10.1214/aos/1031594731). The standard error comes from the scatter of independent scramblings.

    Raises
    ------
    SceneError
        The noise is 0, so that there is no limit.
    """
    if not 0 < prior.noise_mm < np.inf:
        message = (
            f"sensors: with a noise of {prior.noise_mm:g} mm there is no accuracy limit; state the noise of a reading"
        )
        raise SceneError(message)
    drawn = draw_evenly(prior, draws, seed)
    deviation = posterior_quantiles(prior, drawn.deflection_mm)[1] * drawn.weight
    return _mean_of(deviation.reshape(SCRAMBLINGS, -1).mean(axis=1) / prior.length_mm * 100)


def draw_evenly(prior: Prior, count: int, seed: int) -> Draws:
    """Draw at least `count` contacts like `draw`, but spread evenly over their distribution.

    They come in SCRAMBLINGS consecutive parts of equal length. The parts are independent, so the scatter of their
    means gives a standard error. Half of the contacts are drawn where the Cramer-Rao bound is large, for example next
    to a support, with smaller weights; otherwise a few contacts would dominate a mean.
    """
    rngs = np.random.default_rng(seed).spawn(SCRAMBLINGS)
    each = 2 ** max(0, int(np.ceil(np.log2(count / SCRAMBLINGS))))
    contacts = [spread_contacts(prior, each, rng) for rng in rngs]
    position, force = (np.concatenate([contact[part] for contact in contacts]) for part in (0, 1))
    noise = np.concatenate([contact[2] for contact in contacts])
    position, weight = _where_it_errs(prior, position)
    clean = force[:, None] * prior.influence_at(position)
    return Draws(position, force, clean + prior.noise_mm * noise, weight)


def _where_it_errs(prior: Prior, position_mm: Floats) -> tuple[Floats, Floats]:
    """Concentrate evenly spread positions where errors are large; returns positions and weights, both (draws,)."""
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


def spread_noise(channels: int, draws: int, rng: np.random.Generator) -> Floats:
    """Return noise of variance 1 (draws, channels) spread evenly over its distribution; `draws` is a power of two."""
    noise: Floats = ndtri(_spread(channels, draws, rng))
    return noise


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


def posterior_quantiles(prior: Prior, deflection_mm: Floats, levels: Floats | None = None) -> tuple[Floats, Floats]:
    """Return quantiles of the position, and the mean distance from the median, for readings (draws, channels).

    `levels` are (draws, levels) between 0 and 1, by default the median alone. Returns quantiles (draws, levels) and
    distances (draws,), in mm.

    All draws share one grid over the range; narrow posteriors are computed again on grids of their own until the grid
    resolves them.
    """
    levels = np.full((len(deflection_mm), 1), 0.5) if levels is None else levels
    grid = np.linspace(*prior.position_mm, GRID)
    influence = prior.influence_at(grid)
    largest = prior.force_n[1] * float(np.abs(influence).max())
    if not prior.noise_mm >= MIN_NOISE * largest:
        message = (
            f"sensors: a noise of {prior.noise_mm:g} mm is too small to compute with next to a deflection "
            f"of {largest:.3g} mm; state a larger one"
        )
        raise SceneError(message)
    shapes = influence / prior.noise_mm
    size = np.linalg.norm(shapes, axis=1)
    direction = shapes / np.where(size > 0, size, 1.0)[:, None]
    found = []
    for start in range(0, len(deflection_mm), CHUNK):
        reading = deflection_mm[start : start + CHUNK] / prior.noise_mm
        projection = reading @ direction.T
        density = log_likelihood(prior.force_n, size, projection, projection**2 / 2)
        grids = np.broadcast_to(grid, density.shape)
        found.append(_resolved(prior, reading, grids, density, levels[start : start + CHUNK]))
    whole = np.concatenate(found)
    return whole[:, :-1], whole[:, -1]


def _resolved(prior: Prior, reading: Floats, grids: Floats, density: Floats, levels: Floats) -> Floats:
    """Return quantiles and mean distance (draws, levels + 1) of log densities, on finer grids where needed."""
    found = np.empty((len(reading), levels.shape[1] + 1))
    todo = np.arange(len(reading))
    for _ in range(ROUNDS):
        finer, narrow = _finer(grids, density)
        done = densities(grids[~narrow], density[~narrow])
        found[todo[~narrow], :-1] = done.quantiles(levels[todo[~narrow]])
        found[todo[~narrow], -1] = done.mean_distance()
        grids, todo = finer, todo[narrow]
        if not len(todo):
            return found
        shapes = prior.influence_at(grids.ravel()).reshape(*grids.shape, -1) / prior.noise_mm
        size = np.linalg.norm(shapes, axis=2)
        direction = shapes / np.where(size > 0, size, 1.0)[:, :, None]
        projection = np.einsum("dgs,ds->dg", direction, reading[todo])
        # Compute the misfit directly: with little noise a difference of squares would cancel.
        misfit = reading[todo, None, :] - projection[:, :, None] * direction
        density = log_likelihood(prior.force_n, size, projection, -np.einsum("dgs,dgs->dg", misfit, misfit) / 2)
    last = densities(grids, density)
    found[todo] = np.column_stack([last.quantiles(levels[todo]), last.mean_distance()])
    return found


def _finer(grids: Floats, density: Floats) -> tuple[Floats, Bools]:
    """Return finer grids over the cells of each posterior, with a margin of two cells, and which posteriors are narrow.

    A posterior in two pieces, such as that of a known force near either support, keeps both.
    """
    likely = np.asarray(density >= density.max(axis=1, keepdims=True) - NEGLIGIBLE)
    around = np.pad(likely, ((0, 0), (2, 2)))
    cells: Bools = np.any([around[:, shift : shift + likely.shape[1] - 1] for shift in range(6)], axis=0)
    narrow: Bools = np.asarray(cells.sum(axis=1) < density.shape[1] / 4)
    length = np.zeros((int(narrow.sum()), grids.shape[1]))
    np.cumsum(np.diff(grids[narrow], axis=1) * cells[narrow], axis=1, out=length[:, 1:])
    part = np.linspace(0, 1, FINE_GRID)
    finer = [np.interp(part * along[-1], along, grid) for along, grid in zip(length, grids[narrow], strict=True)]
    return np.array(finer), narrow


def log_likelihood(force_n: tuple[float, float], size: Floats, projection: Floats, fit: Floats) -> Floats:
    """Return the log likelihood of readings at grid positions, in units of the noise; (draws, grid).

    Parameters
    ----------
    force_n : the range of forces, with equal ends if the force is known
    size : (grid,) or (draws, grid), length of the vector of deflections per newton
    projection : (draws, grid), of the reading on the direction of that vector
    fit : (draws, grid), minus half the squared misfit, or half the squared projection if that is accurate enough

    Terms that do not depend on the position are left out.
    """
    low, high = force_n
    middle = -((projection - (low + high) / 2 * size) ** 2) / 2
    if low == high:
        return fit + middle
    # Where the force hardly matters, as next to a support, use the midpoint rule.
    flat = size * (high - low) < 1e-4
    length = np.where(flat, 1.0, size)
    span = _log_normal_interval(low * length - projection, high * length - projection) - np.log(length)
    likelihood: Floats = fit + np.where(flat, middle + np.log((high - low) / np.sqrt(2 * np.pi)), span)
    return likelihood


def _log_normal_interval(low: Floats, high: Floats) -> Floats:
    """Return log(Phi(high) - Phi(low)) for low < high, without cancellation in either tail."""
    flip = low + high > 0
    upper, lower = np.where(flip, -low, high), np.where(flip, -high, low)
    log_upper = log_ndtr(upper)
    difference: Floats = log_upper + np.log(-np.expm1(np.minimum(log_ndtr(lower) - log_upper, -1e-300)))
    return difference
