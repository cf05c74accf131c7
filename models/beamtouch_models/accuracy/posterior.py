"""The posterior of the position, with the force integrated out exactly.

For a given position the likelihood is Gaussian in the force, so its integral over the range of forces is a difference
of normal distribution functions.
"""

import numpy as np
from scipy.special import log_ndtr

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
CHUNK = 100
"""Readings per step, few enough for their grids to fit the cache of a core."""
MIN_NOISE = 1e-12
"""Smallest noise of a sample over the largest deflection: below it, rounding in float64 shows in the posterior."""


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
