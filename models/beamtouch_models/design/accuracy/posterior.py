"""The posterior of the position on a beam: quantiles, and the mean distance from the median.

Between the nodes of a grid a distribution function is integrated with the derivatives at both ends (the corrected
trapezoidal rule), which is exact for cubics: with four nodes in a standard deviation the mean distance is off by 2e-4
of itself. The densities at the nodes are those of `likelihood`.
"""

from dataclasses import dataclass

import numpy as np

from beamtouch_models.arrays import Bools, Floats, Indices
from beamtouch_models.design.accuracy.likelihood import NEGLIGIBLE, log_density, possible_rise
from beamtouch_models.design.accuracy.prior import Forces, Prior, forces_of
from beamtouch_models.places import on_axis

GRID = 801
"""Positions over the whole range."""
FINE_GRID = 129
ROUNDS = 12
CHUNK = 100
"""Samples per step, few enough for their grids to fit the cache of a core."""
MIN_LOG = -700.0
"""Smallest log density, relative to the maximum. Its exponential is a normal number: subnormal ones take long."""
SHARP = 1.0
"""Change of a log density's slope between cells, times the cell length, beyond which the grid does not resolve it."""


def posterior_quantiles(
    prior: Prior,
    deflection_mm: Floats,
    levels: Floats | None = None,
    *,
    whitening_per_mm: Floats | None = None,
    tail: float = 0.0,
) -> tuple[Floats, Floats]:
    """Return quantiles of the position, and the mean distance from the median, for samples (draws, channels).

    `levels` are (draws, levels) between 0 and 1, by default the median alone. `whitening_per_mm` (draws, channels,
    channels) states the covariance of each sample, by default that of the prior. `tail` is the share of forces outside
    the range (`forces_of`). Returns quantiles (draws, levels) and distances (draws,), in mm.

    All draws share one grid over the range; narrow posteriors are computed again on grids of their own until the grid
    resolves them.
    """
    levels = np.full((len(deflection_mm), 1), 0.5) if levels is None else levels
    grid = np.linspace(*prior.extent.range_mm, GRID)
    influence = prior.influence_within_noise(on_axis(grid))
    whitening = prior.errors.whitening(deflection_mm) if whitening_per_mm is None else whitening_per_mm
    forces = forces_of(prior.force_n, tail)
    parts = []
    for start in range(0, len(deflection_mm), CHUNK):
        part = slice(start, start + CHUNK)
        seen = _WhitenedSamples(whitening[part], np.einsum("dij,dj->di", whitening[part], deflection_mm[part]))
        density = _log_density(prior, seen, forces, grid[None], influence[None])
        parts.append(_resolved(prior, forces, seen, np.broadcast_to(grid, density.shape), density, levels[part]))
    summary = np.concatenate(parts)
    return summary[:, :-1], summary[:, -1]


@dataclass(frozen=True)
class _WhitenedSamples:
    """Samples in units of their uncertainty."""

    whitening: Floats
    """(draws, channels, channels)"""
    sample: Floats
    """(draws, channels)"""

    def take(self, rows: Indices) -> "_WhitenedSamples":
        return _WhitenedSamples(self.whitening[rows], self.sample[rows])


def _log_density(prior: Prior, seen: _WhitenedSamples, forces: Forces, grids: Floats, influence: Floats) -> Floats:
    """Return log densities (draws, grid) at the nodes of grids (draws or 1, grid) with their influence."""
    variance = None if prior.variance_table is None else prior.variance_table(grids[..., None])
    return log_density(forces, seen.whitening, seen.sample, influence, variance, prior.shared)


def _resolved(
    prior: Prior, forces: Forces, seen: _WhitenedSamples, grids: Floats, density: Floats, levels: Floats
) -> Floats:
    """Return quantiles and mean distance (draws, levels + 1) of log densities, on finer grids where needed."""
    summary = np.empty((len(grids), levels.shape[1] + 1))
    todo = np.arange(len(grids))
    for _ in range(ROUNDS):
        finer, narrow = _finer(grids, density)
        done = todo[~narrow]
        summary[done] = summaries(grids[~narrow], density[~narrow], levels[done])
        grids, todo = finer, todo[narrow]
        if not len(todo):
            return summary
        influence = prior.influence_within_noise(on_axis(grids.ravel())).reshape(*grids.shape, prior.channels)
        density = _log_density(prior, seen.take(todo), forces, grids, influence)
    summary[todo] = summaries(grids, density, levels[todo])
    return summary


def _finer(grids: Floats, density: Floats) -> tuple[Floats, Bools]:
    """Return finer grids over the cells of each posterior, with a margin of two cells, and which posteriors are narrow.

    A posterior in two pieces, such as that of a known force near either support, keeps both.
    """
    likely = np.asarray(density + possible_rise(density, 1) >= density.max(axis=1, keepdims=True) - NEGLIGIBLE)
    around = np.pad(likely, ((0, 0), (2, 2)))
    cells: Bools = np.any([around[:, shift : shift + likely.shape[1] - 1] for shift in range(6)], axis=0)
    narrow: Bools = np.asarray(cells.sum(axis=1) < density.shape[1] / 4)
    length = np.zeros((int(narrow.sum()), grids.shape[1]))
    np.cumsum(np.diff(grids[narrow], axis=1) * cells[narrow], axis=1, out=length[:, 1:])
    part = np.linspace(0, 1, FINE_GRID)
    finer = [np.interp(part * along[-1], along, grid) for along, grid in zip(length, grids[narrow], strict=True)]
    return np.array(finer), narrow


def summaries(grids: Floats, log_density: Floats, levels: Floats) -> Floats:
    """Return quantiles and mean distance from the median (draws, levels + 1) of densities on increasing grids.

    Grids and log densities, up to a constant, are (draws, grid), levels (draws, levels) between 0 and 1.
    """
    density, below = _distributions(grids, log_density)
    levels = np.column_stack([levels, np.full(len(levels), 0.5)])
    rows, nodes = below.shape
    # A single search serves all rows: stacked, the functions rise from 0 to the number of rows.
    stacked = below + np.arange(rows)[:, None]
    above = np.searchsorted(stacked.ravel(), (levels + np.arange(rows)[:, None]).ravel()).reshape(levels.shape)
    cell = np.clip(above - 1 - nodes * np.arange(rows)[:, None], 0, nodes - 2)

    def at_ends(values: Floats) -> tuple[Floats, Floats]:
        """Return values at both ends of the cell of each level."""
        return np.take_along_axis(values, cell, axis=1), np.take_along_axis(values, cell + 1, axis=1)

    (low, high), (before, after), (start, end) = at_ends(below), at_ends(density), at_ends(grids)
    share = np.clip((levels - low) / np.maximum(high - low, np.finfo(np.float64).tiny), 0.0, 1.0)
    # The root of b t + (a - b) t^2 / 2 = share (b + a) / 2, before and after, in the form that does not cancel.
    root = before + np.sqrt(before**2 + (after**2 - before**2) * share)
    part = np.divide(share * (before + after), root, out=share.copy(), where=root > 0)
    quantiles = start + part * (end - start)
    length = grids[:, -1:] - grids[:, :1]
    step = np.diff(grids, axis=1) / length
    integral = np.zeros_like(below)
    areas = step * (below[:, 1:] + below[:, :-1]) / 2 - step**2 / 12 * np.diff(density, axis=1)
    np.cumsum(areas, axis=1, out=integral[:, 1:])
    # Within the cell of the median, which is the last level, the density is a straight line.
    along = np.take_along_axis(step, cell, axis=1)[:, -1] * part[:, -1]
    rise = before[:, -1] / 2 + (after - before)[:, -1] * part[:, -1] / 6
    to_median = at_ends(integral)[0][:, -1] + along * (low[:, -1] + along * rise)
    beyond = 1 - (start[:, -1] - grids[:, 0]) / length[:, 0] - along
    distance = length[:, 0] * (2 * to_median - integral[:, -1] + beyond)
    return np.column_stack([quantiles[:, :-1], distance])


def _distributions(grids: Floats, log_density: Floats) -> tuple[Floats, Floats]:
    """Return densities, in units of one over the length of a grid, and distribution functions at the nodes."""
    logs = log_density - log_density.max(axis=1, keepdims=True)
    np.maximum(logs, MIN_LOG, out=logs)
    density = np.exp(logs)
    step = np.diff(grids, axis=1) / (grids[:, -1:] - grids[:, :1])
    slope = np.diff(logs, axis=1) / np.where(step > 0, step, np.inf)
    # The log of a posterior is nearly a parabola: its derivative at a node is the mean of the adjacent slopes.
    gradient = np.empty_like(density)
    gradient[:, 1:-1] = (slope[:, :-1] + slope[:, 1:]) / 2
    gradient[:, 0], gradient[:, -1] = slope[:, 0], slope[:, -1]
    bend = np.diff(gradient * density, axis=1)
    # At a cliff, where the end of the force range cuts a posterior off, it is not: use the plain trapezoidal rule.
    sharp = np.empty(density.shape, np.bool_)
    sharp[:, 1:-1] = np.abs(np.diff(slope, axis=1)) * np.maximum(step[:, 1:], step[:, :-1]) > SHARP
    sharp[:, 0], sharp[:, -1] = sharp[:, 1], sharp[:, -2]
    bend[sharp[:, 1:] | sharp[:, :-1]] = 0.0
    mass = step * (density[:, 1:] + density[:, :-1]) / 2 - step**2 / 12 * bend
    below = np.zeros_like(density)
    np.cumsum(np.maximum(mass, 0.0, out=mass), axis=1, out=below[:, 1:])
    total = below[:, -1:].copy()
    return density / total, below / total
