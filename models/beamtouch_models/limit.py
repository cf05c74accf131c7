"""The accuracy limit: the mean position error that no estimator can beat, for what is known of a surface.

Position and force are drawn uniformly from their ranges, noise is added, and the posterior median of position is
taken: of all estimators it has the smallest mean absolute error. The force is integrated out exactly: for a given
position the likelihood is Gaussian in the force, so its integral over the range is a difference of normal
distribution functions.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_ndtr, ndtri

from beamtouch_models.errors import SceneError
from beamtouch_models.prior import Prior

Array = NDArray[np.float64]

GRID = 801
"""Positions over the whole range."""
FINE_GRID = 129
ROUNDS = 12
NEGLIGIBLE = 40.0
"""What is this much less likely, in log units, than the most likely position is no part of a posterior."""
CHUNK = 200
SCRAMBLINGS = 16
LEAST_NOISE = 1e-12
"""Noise of a sample over the largest deflection: with less, rounding in float64 shows in the posterior."""


@dataclass(frozen=True)
class Draws:
    """Simulated contacts: what happened and what the sensors said."""

    position_mm: Array
    force_n: Array
    deflection_mm: Array
    """(draws, sensors), with noise."""


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


def mean_error(prior: Prior, draws: Draws, estimate_mm: Array) -> MeanError:
    """Eq. 5 of the paper over all draws."""
    return _mean_of(np.abs(estimate_mm - draws.position_mm) / prior.length_mm * 100)


def _mean_of(percent: Array) -> MeanError:
    """Mean of errors in percent of the length, with its standard error from their scatter."""
    return MeanError(float(percent.mean()), float(percent.std(ddof=1) / np.sqrt(len(percent))))


def accuracy_limit(prior: Prior, draws: int, seed: int) -> MeanError:
    """Accuracy limit, from at least that many simulated contacts.

    The average is that of `mean_error`, with less scatter: for each reading it takes the mean of |error| over the
    posterior instead of the one error that was drawn, and contacts and noise are spread evenly (scrambled Sobol
    points; Owen 1997, doi 10.1214/aos/1031594731). The standard error is that between independent scramblings.

    Raises
    ------
    SceneError
        The noise is 0: there is no limit to state.
    """
    if not 0 < prior.noise_mm < np.inf:
        message = (
            f"sensors: with a noise of {prior.noise_mm:g} mm there is no accuracy limit; state the noise of a reading"
        )
        raise SceneError(message)
    rngs = np.random.default_rng(seed).spawn(SCRAMBLINGS)
    each = 2 ** max(0, int(np.ceil(np.log2(draws / SCRAMBLINGS))))
    contacts = [spread_contacts(prior, each, rng) for rng in rngs]
    position, force = (np.concatenate([contact[part] for contact in contacts]) for part in (0, 1))
    noise = np.concatenate([contact[2] for contact in contacts])
    reading = force[:, None] * prior.influence_at(position) + prior.noise_mm * noise
    deviation = posterior_median(prior, reading)[1]
    means = deviation.reshape(SCRAMBLINGS, each).mean(axis=1) / prior.length_mm * 100
    return _mean_of(means)


def spread_contacts(prior: Prior, draws: int, rng: np.random.Generator) -> tuple[Array, Array, Array]:
    """Contacts and noise that fill their distributions evenly; `draws` is a power of two.

    Returns
    -------
    positions in mm (draws,), forces in N (draws,), and noise of variance 1 (draws, channels).
    """
    from scipy.stats.qmc import Sobol  # noqa: PLC0415  # takes long to import, and many commands need none

    points = Sobol(prior.channels + 2, rng=rng).random(draws)
    low, high = prior.position_mm
    weak, strong = prior.force_n
    # The middle of a point's last digit, so that no noise is infinite.
    noise = ndtri(np.clip(points[:, 2:], 2.0**-32, 1 - 2.0**-32))
    return low + (high - low) * points[:, 0], weak + (strong - weak) * points[:, 1], noise


def posterior_median_mm(prior: Prior, deflection_mm: Array) -> Array:
    """Posterior median of the position for each row of `deflection_mm` (draws, channels); (draws,) in mm.

    The noise must be positive.
    """
    return posterior_median(prior, deflection_mm)[0]


def posterior_median(prior: Prior, deflection_mm: Array) -> tuple[Array, Array]:
    """Posterior median and the posterior's mean distance from it, both (draws,) in mm; as `posterior_median_mm`.

    One grid over the range serves all draws; where a posterior is narrow it is computed again on a grid of its own,
    until the grid resolves it.
    """
    grid = np.linspace(*prior.position_mm, GRID)
    influence = prior.influence_at(grid)
    largest = prior.force_n[1] * float(np.abs(influence).max())
    if not prior.noise_mm >= LEAST_NOISE * largest:
        message = (
            f"sensors: a noise of {prior.noise_mm:g} mm is too small to compute with beside a deflection of "
            f"{largest:.3g} mm; state a larger one"
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
        found.append(_resolved(prior, reading, grids, density))
    median, deviation = np.concatenate(found, axis=1)
    return median, deviation


def _resolved(prior: Prior, reading: Array, grids: Array, density: Array) -> Array:
    """Medians and deviations (2, draws) of log densities (draws, grid), on finer grids where theirs are too coarse."""
    found = np.stack(median_and_deviation(grids, density))
    todo = np.arange(len(reading))
    for _ in range(ROUNDS):
        grids, narrow = _finer(grids, density)
        todo = todo[narrow]
        if not len(todo):
            break
        shapes = prior.influence_at(grids.ravel()).reshape(*grids.shape, -1) / prior.noise_mm
        size = np.linalg.norm(shapes, axis=2)
        direction = shapes / np.where(size > 0, size, 1.0)[:, :, None]
        projection = np.einsum("dgs,ds->dg", direction, reading[todo])
        # The misfit itself, not a difference of squares: with little noise those are large and nearly equal.
        misfit = reading[todo, None, :] - projection[:, :, None] * direction
        density = log_likelihood(prior.force_n, size, projection, -np.einsum("dgs,dgs->dg", misfit, misfit) / 2)
        found[:, todo] = median_and_deviation(grids, density)
    return found


def _finer(grids: Array, density: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Grids over the cells that hold a posterior, with two to spare, and whether those are a small part of its grid.

    A posterior in two pieces, as of a known force near either support, keeps both.
    """
    likely = np.asarray(density >= density.max(axis=1, keepdims=True) - NEGLIGIBLE)
    around = np.pad(likely, ((0, 0), (2, 2)))
    cells: NDArray[np.bool_] = np.any([around[:, shift : shift + likely.shape[1] - 1] for shift in range(6)], axis=0)
    narrow: NDArray[np.bool_] = np.asarray(cells.sum(axis=1) < density.shape[1] / 4)
    length = np.zeros((int(narrow.sum()), grids.shape[1]))
    np.cumsum(np.diff(grids[narrow], axis=1) * cells[narrow], axis=1, out=length[:, 1:])
    part = np.linspace(0, 1, FINE_GRID)
    finer = [np.interp(part * along[-1], along, grid) for along, grid in zip(length, grids[narrow], strict=True)]
    return np.array(finer), narrow


def log_likelihood(force_n: tuple[float, float], size: Array, projection: Array, fit: Array) -> Array:
    """Log likelihood of readings at grid positions, in units of the noise; (draws, grid).

    Parameters
    ----------
    force_n : the range, equal ends where the force is known
    size : (grid,) or (draws, grid), length of the vector of deflections per newton
    projection : (draws, grid), of the reading on the direction of that vector
    fit : (draws, grid), minus half the squared misfit, or half the squared projection where that will do

    Constants that do not depend on the position are left out.
    """
    low, high = force_n
    middle = -((projection - (low + high) / 2 * size) ** 2) / 2
    if low == high:
        return fit + middle
    # Where the force hardly matters, as beside a support, the integral is its midpoint times its width.
    flat = size * (high - low) < 1e-4
    length = np.where(flat, 1.0, size)
    span = _log_normal_interval(low * length - projection, high * length - projection) - np.log(length)
    likelihood: Array = fit + np.where(flat, middle + np.log((high - low) / np.sqrt(2 * np.pi)), span)
    return likelihood


def _log_normal_interval(low: Array, high: Array) -> Array:
    """Logarithm of Phi(high) - Phi(low), low < high, without cancellation in either tail."""
    flip = low + high > 0
    upper, lower = np.where(flip, -low, high), np.where(flip, -high, low)
    log_upper = log_ndtr(upper)
    difference: Array = log_upper + np.log(-np.expm1(np.minimum(log_ndtr(lower) - log_upper, -1e-300)))
    return difference


def median_and_deviation(grids: Array, log_density: Array) -> tuple[Array, Array]:
    """Median of each density (draws, grid) on its grid and the mean distance from it; both (draws,).

    By the trapezoidal rule, the distribution function linear within a cell. The mean distance from the median is the
    integral of the smaller of F and 1 - F.
    """
    density = np.exp(log_density - log_density.max(axis=1, keepdims=True))
    widths = np.diff(grids, axis=1)
    below = np.zeros_like(density)
    np.cumsum(
        (density[:, 1:] + density[:, :-1]) / 2 * (widths / (grids[:, -1:] - grids[:, :1])), axis=1, out=below[:, 1:]
    )
    below /= below[:, -1:]
    cell = np.clip((below < 0.5).sum(axis=1) - 1, 0, density.shape[1] - 2)
    rows = np.arange(len(cell))
    before, after, width = below[rows, cell], below[rows, cell + 1], widths[rows, cell]
    fraction = (0.5 - before) / np.maximum(after - before, np.finfo(np.float64).tiny)
    nearer = np.minimum(below, 1 - below)
    areas = (nearer[:, 1:] + nearer[:, :-1]) / 2 * widths
    # In the cell of the median the smaller of the two has its peak, 1/2.
    areas[rows, cell] = width * (fraction * (before + 0.5) + (1 - fraction) * (1.5 - after)) / 2
    return grids[rows, cell] + fraction * width, areas.sum(axis=1)
