"""Densities of the position on the cells of a grid: their sums with the mounting of sensors, and their width."""

import numpy as np

from beamtouch_models.accuracy.densities import MIN_LOG
from beamtouch_models.arrays import Floats

TINY = float(np.finfo(np.float64).tiny)


def with_mounting(
    square_force: Floats, shapes: Floats, moved: Floats, sample: Floats, precision: Floats
) -> tuple[Floats, Floats, Floats]:
    """Return the sums of a density with the mounting, each (contacts, cells).

    They are the weighted squares of the shapes, their products with the sample, and the squares of the sample with the
    logarithm of the variances.

    Parameters
    ----------
    square_force : (contacts, cells), in N^2
    shapes, moved : (cells, sensors), deflection per newton in mm/N, and its variance by the mounting in mm^2/N^2
    sample, precision : (contacts, sensors), in mm and 1/mm^2
    """
    square, along, others = (np.zeros_like(square_force) for _ in range(3))
    volume = np.ones_like(square_force)
    for shape, variance, column, weight in zip(shapes.T, moved.T, sample.T, precision.T, strict=True):
        wider = 1 + square_force * (weight[:, None] * variance)
        volume *= wider
        each = weight[:, None] / wider
        square += each * shape**2
        each *= column[:, None]
        along += each * shape
        each *= column[:, None]
        others += each
    return square, along, others + np.log(volume)


def mean_distances(edges_mm: Floats, log_density: Floats) -> Floats:
    """Return the mean distance from the median in mm (contacts,) of densities that are constant within each cell.

    Parameters
    ----------
    edges_mm : (cells + 1,)
    log_density : (contacts, cells), each row up to a constant
    """
    width = np.diff(edges_mm)
    # In place: fresh memory for each step takes longer than the step.
    work = log_density - log_density.max(axis=1, keepdims=True)
    np.exp(np.maximum(work, MIN_LOG, out=work), out=work)
    work *= width
    below = np.cumsum(work, axis=1, out=work)
    below /= below[:, -1:]
    median = (below >= 0.5).argmax(axis=1)
    rows = np.arange(len(below))
    before, after = np.where(median > 0, below[rows, median - 1], 0.0), below[rows, median]
    # The mean distance is the integral of the smaller of the distribution function and its complement.
    ends = np.minimum(below, 1 - below, out=below)
    trapezoids: Floats = ends @ (width + np.append(width[1:], 0.0)) / 2
    missing = (0.5 - before) * (after - 0.5) / np.maximum(after - before, TINY)
    found: Floats = trapezoids + width[median] * missing
    return found
