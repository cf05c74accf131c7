"""The posterior of a place over cells of any number of axes: its median along each axis, and the mean distance from it.

A box of cells is laid around what is likely, again and again, until it no longer shrinks by half. So its cells are
small beside the posterior wherever that is compact; a thin curve across a plate, as one or two sensors leave it, they
do not resolve. Beams have an integration of their own, which is exact to 2e-4
(`posterior`).
"""

from dataclasses import dataclass

import numpy as np

from beamtouch_models.arrays import Floats
from beamtouch_models.design.accuracy.likelihood import NEGLIGIBLE, log_density, possible_rise
from beamtouch_models.design.accuracy.prior import Prior, forces_of
from beamtouch_models.places import Extent, distances_mm

CELLS = 64
"""Cells along each axis of a box."""


@dataclass(frozen=True)
class Summaries:
    """Posteriors of samples."""

    median_mm: Floats
    """(draws, axes), the median along each axis."""
    distance_mm: Floats
    """(draws,), the mean distance from it."""
    likely_mm: Floats
    """(draws, levels, axes), places that stand for a posterior; of each level, the place below which as much of it lies
    if cells are counted one row after the other."""


def summarize(prior: Prior, deflection_mm: Floats, levels: Floats | None = None) -> Summaries:
    """Return the posteriors of samples (draws, channels), and their places at levels (draws, levels) from 0 to 1.

    Forces are those of the range. The noise must be positive.
    """
    whitening = prior.errors.whitening(deflection_mm)
    samples = np.einsum("dij,dj->di", whitening, deflection_mm)
    forces, first, axes = forces_of(prior.force_n, 0.0), _influence_in(prior, prior.extent), prior.extent.axes
    levels = np.empty((len(samples), 0)) if levels is None else levels
    medians, distances, likely = np.empty((len(samples), axes)), np.empty(len(samples)), np.empty((*levels.shape, axes))
    for row in range(len(samples)):
        box, at_middles = prior.extent, first
        while True:
            density = log_density(forces, whitening[[row]], samples[[row]], *at_middles)[0].reshape([CELLS] * box.axes)
            smaller = _likely_box(box, density)
            if np.prod(smaller.size_mm) > np.prod(box.size_mm) / 2:
                break
            box, at_middles = smaller, _influence_in(prior, smaller)
        medians[row], distances[row], likely[row] = _summary(box, density, levels[row])
    return Summaries(medians, distances, likely)


def _influence_in(prior: Prior, box: Extent) -> tuple[Floats, Floats | None]:
    """Return the influence at the middles of the cells of a box, and its variance, each (1, cells, channels)."""
    ticks = box.middle_ticks(CELLS)
    variance = None if prior.variance_table is None else prior.variance_table.on_grid(ticks)[None]
    return prior.influence_on_grid(ticks)[None], variance


def _likely_box(box: Extent, density: Floats) -> Extent:
    """Return the box of the cells that are likely, with two cells of margin.

    `density` has the cells of each axis.
    """
    rise = sum(possible_rise(density, axis) for axis in range(density.ndim))
    likely = density + rise >= density.max() - NEGLIGIBLE
    ranges = []
    for axis, (low, high) in enumerate(box.ranges_mm):
        other_axes = tuple(index for index in range(density.ndim) if index != axis)
        cells = np.flatnonzero(likely.any(axis=other_axes))
        first, last = max(int(cells[0]) - 2, 0), min(int(cells[-1]) + 3, CELLS)
        ranges.append((low + (high - low) * first / CELLS, low + (high - low) * last / CELLS))
    return Extent(tuple(ranges))


def _summary(box: Extent, density: Floats, levels: Floats) -> tuple[Floats, float, Floats]:
    """Return the median along each axis (axes,), the mean distance from it, and the places at `levels`, of a box."""
    mass = np.exp(density - density.max())
    mass /= mass.sum()
    median = np.empty(box.axes)
    for axis, ends in enumerate(box.ranges_mm):
        marginal = mass.sum(axis=tuple(other_axis for other_axis in range(box.axes) if other_axis != axis))
        median[axis] = np.interp(0.5, np.concatenate([[0.0], np.cumsum(marginal)]), np.linspace(*ends, CELLS + 1))
    middles, below = box.middles(CELLS), np.cumsum(mass)
    cells = np.minimum(np.searchsorted(below, levels * below[-1]), len(middles) - 1)
    return median, float(mass.ravel() @ distances_mm(middles - median)), middles[cells]
