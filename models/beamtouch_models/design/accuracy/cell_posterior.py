"""The posterior of a place over cells of any number of axes: its median along each axis, and the mean distance from it.

A box of cells is laid around what is likely, again and again, until it no longer shrinks by half, and finer cells over
the last one. So cells are small beside the posterior wherever that is compact; a thin curve across a plate, as one or
two sensors leave it, they do not resolve. Samples go in parts, each with a box of its own. Beams have an integration of
their own, which is exact to 2e-4 (`posterior`).
"""

from dataclasses import dataclass
from functools import partial

import numpy as np

from beamtouch_models.arrays import Floats
from beamtouch_models.design.accuracy.likelihood import NEGLIGIBLE, log_density, possible_rise
from beamtouch_models.design.accuracy.prior import Prior, forces_of

CELLS, SOUGHT_CELLS = 64, 32
"""Cells along each axis of the last box, and of those before it."""
MARGIN = 2
"""Cells of margin around the likely ones."""
AT_ONCE = 16
"""Samples in a part: their densities stay in the processor's cache."""


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


@dataclass(frozen=True)
class _Boxes:
    """Boxes of places, one for each of some samples, in mm."""

    low: Floats
    """(draws, axes)"""
    size: Floats
    """(draws, axes)"""

    def ticks(self, cells: int) -> list[Floats]:
        """Return the middles of cells along each axis, arrays (draws, cells)."""
        share = (np.arange(cells) + 0.5) / cells
        return [low[:, None] + size[:, None] * share for low, size in zip(self.low.T, self.size.T, strict=True)]


def summarize(prior: Prior, deflection_mm: Floats, levels: Floats | None = None) -> Summaries:
    """Return the posteriors of samples (draws, channels), and their places at levels (draws, levels) from 0 to 1.

    Forces are those of the range. The noise must be positive.
    """
    whitening = prior.errors.whitening(deflection_mm)
    samples = np.einsum("dij,dj->di", whitening, deflection_mm)
    levels = np.empty((len(samples), 0)) if levels is None else levels
    parts = [slice(start, start + AT_ONCE) for start in range(0, len(samples), AT_ONCE)]
    each = [_summaries(prior, whitening[part], samples[part], levels[part]) for part in parts]
    return Summaries(*(np.concatenate(values) for values in zip(*each, strict=True)))


def _summaries(prior: Prior, whitening: Floats, samples: Floats, levels: Floats) -> tuple[Floats, Floats, Floats]:
    """Return medians, mean distances and places at levels of a part of the samples."""
    density_of = partial(log_density, forces_of(prior.force_n, 0.0), shared=prior.shared)
    extent, count = prior.extent, len(samples)
    low, size = np.tile(extent.low_mm, (count, 1)), np.tile(extent.size_mm, (count, 1))
    todo, shared = np.arange(count), slice(1)  # all begin with the same box
    while len(todo):
        boxes = _Boxes(low[todo], size[todo])
        influence = prior.influence_in(_Boxes(boxes.low[shared], boxes.size[shared]).ticks(SOUGHT_CELLS))
        smaller = _likely_boxes(boxes, density_of(whitening[todo], samples[todo], *influence))
        low[todo], size[todo] = smaller.low, smaller.size
        todo, shared = todo[smaller.size.prod(axis=1) <= boxes.size.prod(axis=1) / 2], slice(None)
    ticks = _Boxes(low, size).ticks(CELLS)
    density = density_of(whitening, samples, *prior.influence_in(ticks))
    return _summary(ticks, density, levels)


def _likely_boxes(boxes: _Boxes, density: Floats) -> _Boxes:
    """Return the boxes of the cells that are likely, with a margin; densities are (draws, cells)."""
    axes = boxes.low.shape[1]
    density = density.reshape(-1, *[SOUGHT_CELLS] * axes)
    rise = sum(possible_rise(density, axis) for axis in range(1, axes + 1))
    likely = density + rise >= density.max(axis=tuple(range(1, axes + 1)), keepdims=True) - NEGLIGIBLE
    low, size = np.empty_like(boxes.low), np.empty_like(boxes.size)
    for axis in range(axes):
        along = likely.any(axis=tuple(1 + other for other in range(axes) if other != axis))
        first = np.maximum(along.argmax(axis=1) - MARGIN, 0)
        last = np.minimum(SOUGHT_CELLS - along[:, ::-1].argmax(axis=1) + MARGIN, SOUGHT_CELLS)
        cell = boxes.size[:, axis] / SOUGHT_CELLS
        low[:, axis], size[:, axis] = boxes.low[:, axis] + first * cell, (last - first) * cell
    return _Boxes(low, size)


def _summary(ticks: list[Floats], density: Floats, levels: Floats) -> tuple[Floats, Floats, Floats]:
    """Return median (draws, axes), mean distance and places at levels of densities (draws, cells) at ticks."""
    draws, axes = len(density), len(ticks)
    mass = np.exp(density - density.max(axis=1, keepdims=True))
    mass /= mass.sum(axis=1, keepdims=True)
    on_grid = mass.reshape(draws, *[CELLS] * axes)
    median = np.empty((draws, axes))
    square = np.zeros(on_grid.shape)
    for axis, middles in enumerate(ticks):
        others = tuple(1 + other for other in range(axes) if other != axis)
        along = on_grid.sum(axis=others)
        below = np.cumsum(along, axis=1)
        cell, rows = (below < 0.5).sum(axis=1), np.arange(draws)
        # From the middle of its cell, in cells, over which the density is taken as even.
        part = (0.5 - below[rows, cell]) / along[rows, cell] + 0.5
        median[:, axis] = middles[rows, cell] + part * (middles[:, 1] - middles[:, 0])
        square += np.expand_dims((middles - median[:, [axis]]) ** 2, others)
    distance = np.einsum("dc,dc->d", mass, np.sqrt(square).reshape(draws, -1))
    below = np.cumsum(mass, axis=1)
    wanted = levels * below[:, -1:]
    found = [np.searchsorted(*pair) for pair in zip(below, wanted, strict=True)]
    cell = np.minimum(np.reshape(found, levels.shape).astype(np.intp), mass.shape[1] - 1)
    cells = np.unravel_index(cell, on_grid.shape[1:])
    places = [np.take_along_axis(middles, index, axis=1) for middles, index in zip(ticks, cells, strict=True)]
    return median, distance, np.stack(places, axis=-1)
