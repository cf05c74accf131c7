"""The accuracy limit: the mean position error that no estimator can beat on a scene, for a layout and a noise.

Position and force are drawn uniformly from the scene's ranges, noise is added, and the posterior median of position is
taken: of all estimators it has the smallest mean absolute error. The force is integrated out exactly: for a given
position the likelihood is Gaussian in the force, so its integral over the range is a difference of normal
distribution functions.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_ndtr

from beamtouch_models.beam import influence
from beamtouch_models.scene import Scene

Array = NDArray[np.float64]

GRID = 3201
CHUNK = 200


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


def draw(scene: Scene, sensor_mm: Array, noise_mm: float, count: int, seed: int) -> Draws:
    """Draw contacts uniformly from the scene's ranges, with Gaussian noise of `noise_mm` per channel."""
    rng = np.random.default_rng(seed)
    position = rng.uniform(*scene.contact.position_mm, size=count)
    force = rng.uniform(*scene.contact.force_range_n, size=count)
    clean = force[:, None] * influence(scene.beam, sensor_mm, position)
    return Draws(position, force, clean + rng.normal(scale=noise_mm, size=clean.shape))


def mean_error(scene: Scene, draws: Draws, estimate_mm: Array) -> MeanError:
    """Eq. 5 of the paper over all draws."""
    percent = np.abs(estimate_mm - draws.position_mm) / scene.beam.length_mm * 100
    return MeanError(float(percent.mean()), float(percent.std(ddof=1) / np.sqrt(len(percent))))


def posterior_median_mm(scene: Scene, sensor_mm: Array, noise_mm: float, deflection_mm: Array) -> Array:
    """Posterior median of the position for each row of `deflection_mm` (draws, sensors); (draws,) in mm.

    The prior is uniform over the scene's ranges; `noise_mm` must be positive.
    """
    grid = np.linspace(*scene.contact.position_mm, GRID)
    shapes = influence(scene.beam, sensor_mm, grid) / noise_mm
    medians = [
        _median(grid, _log_likelihood(scene, shapes, deflection_mm[start : start + CHUNK] / noise_mm))
        for start in range(0, len(deflection_mm), CHUNK)
    ]
    return np.concatenate(medians)


def _log_likelihood(scene: Scene, shapes: Array, reading: Array) -> Array:
    """Log likelihood of each reading (draws, sensors) at each grid position (grid, sensors); (draws, grid).

    Both in units of the noise. Constants that do not depend on the position are left out.
    """
    size = np.sqrt((shapes**2).sum(axis=1))
    projection = reading @ (shapes / size[:, None]).T
    low, high = scene.contact.force_range_n
    if low == high:
        known: Array = low * size * projection - (low * size) ** 2 / 2
        return known
    span = _log_normal_interval(low * size - projection, high * size - projection)
    log_likelihood: Array = projection**2 / 2 + span - np.log(size)
    return log_likelihood


def _log_normal_interval(low: Array, high: Array) -> Array:
    """Logarithm of Phi(high) - Phi(low), low < high, without cancellation in either tail."""
    flip = low + high > 0
    upper, lower = np.where(flip, -low, high), np.where(flip, -high, low)
    log_upper = log_ndtr(upper)
    difference: Array = log_upper + np.log(-np.expm1(np.minimum(log_ndtr(lower) - log_upper, -1e-300)))
    return difference


def _median(grid: Array, log_density: Array) -> Array:
    """Median of each density (draws, grid) by the trapezoidal rule, linear within a cell."""
    density = np.exp(log_density - log_density.max(axis=1, keepdims=True))
    cumulative = np.zeros_like(density)
    np.cumsum((density[:, 1:] + density[:, :-1]) / 2, axis=1, out=cumulative[:, 1:])
    half = cumulative[:, -1:] / 2
    cell = np.clip((cumulative < half).sum(axis=1) - 1, 0, len(grid) - 2)
    rows = np.arange(len(cell))
    before, after = cumulative[rows, cell], cumulative[rows, cell + 1]
    fraction = (half[:, 0] - before) / np.maximum(after - before, np.finfo(np.float64).tiny)
    median: Array = grid[cell] + fraction * (grid[cell + 1] - grid[cell])
    return median
