"""The posterior of a place over cells of any number of axes: its median along each axis, and the mean distance from it.

A box of cells is laid around what is likely, again and again, until it no longer shrinks by half. So its cells are
small beside the posterior wherever that is in one piece. Beams have an integration of their own, which is exact to 2e-4
(`posterior`).
"""

import numpy as np

from beamtouch_models.arrays import Floats
from beamtouch_models.design.accuracy.likelihood import NEGLIGIBLE, log_density
from beamtouch_models.design.accuracy.prior import Prior, forces_of
from beamtouch_models.places import Extent

CELLS = 64
"""Cells along each axis of a box."""


def medians_and_distances(prior: Prior, deflection_mm: Floats, tail: float = 0.0) -> tuple[Floats, Floats]:
    """Return the posterior medians of samples (draws, channels) along each axis, and the mean distances from them.

    `tail` is the share of forces outside the range (`forces_of`). The noise must be positive.

    Returns
    -------
    (draws, axes) and (draws,), in mm
    """
    whitening = prior.errors.whitening(deflection_mm)
    samples = np.einsum("dij,dj->di", whitening, deflection_mm)
    forces, medians = forces_of(prior.force_n, tail), np.empty((len(samples), prior.extent.axes))
    distances = np.empty(len(samples))
    first = _table(prior, prior.extent)
    for row in range(len(samples)):
        box, table = prior.extent, first
        while True:
            density = log_density(forces, whitening[[row]], samples[[row]], *table)[0].reshape([CELLS] * box.axes)
            smaller = _likely_box(box, density)
            if np.prod(smaller.size_mm) > np.prod(box.size_mm) / 2:
                break
            box, table = smaller, _table(prior, smaller)
        medians[row], distances[row] = _summary(box, density)
    return medians, distances


def _table(prior: Prior, box: Extent) -> tuple[Floats, Floats | None]:
    """Return the influence at the middles of the cells of a box, and its variance, each (1, cells, channels)."""
    middles = box.middles(CELLS**box.axes)
    return prior.influence_within_noise(middles)[None], None if prior.variance is None else prior.variance(middles)[
        None
    ]


def _likely_box(box: Extent, density: Floats) -> Extent:
    """Return the box of the cells that are likely, with two cells of margin.

    `density` has the cells of each axis. Where cells are much wider than a posterior, their middles miss the peak. A
    parabola through three of them, along an axis, rises above the middle one by at most an eighth of its drop to the
    lower neighbour; half of it is allowed for.
    """
    rise = np.zeros_like(density)
    for axis in range(density.ndim):
        ends = [(1, 1) if index == axis else (0, 0) for index in range(density.ndim)]
        beside = np.moveaxis(np.pad(density, ends, mode="edge"), axis, 0)
        lower, higher = np.minimum(beside[:-2], beside[2:]), np.maximum(beside[:-2], beside[2:])
        along = np.moveaxis(density, axis, 0)
        rise += np.moveaxis(np.where(along >= higher, (along - lower) / 2, 0.0), 0, axis)
    likely = density + rise >= density.max() - NEGLIGIBLE
    ranges = []
    for axis, (low, high) in enumerate(box.ranges_mm):
        other_axes = tuple(index for index in range(density.ndim) if index != axis)
        cells = np.flatnonzero(likely.any(axis=other_axes))
        first, last = max(int(cells[0]) - 2, 0), min(int(cells[-1]) + 3, CELLS)
        ranges.append((low + (high - low) * first / CELLS, low + (high - low) * last / CELLS))
    return Extent(tuple(ranges))


def _summary(box: Extent, density: Floats) -> tuple[Floats, float]:
    """Return the median along each axis (axes,), and the mean distance from it, of the cells of a box."""
    mass = np.exp(density - density.max())
    mass /= mass.sum()
    median = np.empty(box.axes)
    for axis, ends in enumerate(box.ranges_mm):
        marginal = mass.sum(axis=tuple(other_axis for other_axis in range(box.axes) if other_axis != axis))
        median[axis] = np.interp(0.5, np.concatenate([[0.0], np.cumsum(marginal)]), np.linspace(*ends, CELLS + 1))
    apart = np.linalg.norm(box.middles(CELLS**box.axes) - median, axis=1)
    return median, float(mass.ravel() @ apart)
