"""Probability densities on grids: their quantiles, and the mean distance from their median. Pure.

Between nodes a distribution function is integrated with the derivatives at both ends (the corrected trapezoidal rule),
which is exact for cubics: with four nodes in a standard deviation the mean distance is off by 2e-4 of itself.
"""

from dataclasses import dataclass

import numpy as np

from beamtouch_models.arrays import Floats, Indices

MIN_LOG = -700.0
"""Smallest log density, relative to the maximum. Its exponential is a normal number: subnormal ones take long."""

SHARP = 1.0
"""Change of a log density's slope between cells, times the cell length, beyond which the grid does not resolve it."""


@dataclass(frozen=True)
class Densities:
    """Densities, each on its own grid; all arrays are (densities, grid)."""

    grids: Floats
    density: Floats
    """At the nodes, in units of one over the length of the grid."""
    below: Floats
    """Distribution function at the nodes."""

    def quantiles(self, levels: Floats) -> Floats:
        """Quantiles (densities, levels) at levels (densities, levels) between 0 and 1."""
        cell, part = self._found(levels)
        low, high = (np.take_along_axis(self.grids, at, axis=1) for at in (cell, cell + 1))
        return low + part * (high - low)

    def mean_distance(self) -> Floats:
        """Mean distance from the median, (densities,)."""
        cell, part = self._found(np.full((len(self.grids), 1), 0.5))
        length = self.grids[:, -1:] - self.grids[:, :1]
        step = np.diff(self.grids, axis=1) / length
        areas = step * (self.below[:, 1:] + self.below[:, :-1]) / 2 - step**2 / 12 * np.diff(self.density, axis=1)
        whole = np.zeros_like(self.below)
        np.cumsum(areas, axis=1, out=whole[:, 1:])
        before, after, start, at, width = (
            np.take_along_axis(values, index, axis=1)
            for values, index in (
                (self.density, cell),
                (self.density, cell + 1),
                (self.below, cell),
                (whole, cell),
                (step, cell),
            )
        )
        # Within the cell the density is a straight line.
        to_median = at + width * part * (start + width * part * (before / 2 + (after - before) * part / 6))
        beyond = 1 - (np.take_along_axis(self.grids, cell, axis=1) - self.grids[:, :1]) / length - width * part
        distance: Floats = (length * (2 * to_median - whole[:, -1:] + beyond))[:, 0]
        return distance

    def _found(self, levels: Floats) -> tuple[Indices, Floats]:
        """Return the cell of each level, and the fraction of the cell below its quantile."""
        rows, nodes = self.below.shape
        # A single search serves all rows: stacked, the functions rise from 0 to the number of rows.
        stacked = self.below + np.arange(rows)[:, None]
        above = np.searchsorted(stacked.ravel(), (levels + np.arange(rows)[:, None]).ravel()).reshape(levels.shape)
        cell = np.clip(above - 1 - nodes * np.arange(rows)[:, None], 0, nodes - 2)
        low, high = (np.take_along_axis(self.below, at, axis=1) for at in (cell, cell + 1))
        before, after = (np.take_along_axis(self.density, at, axis=1) for at in (cell, cell + 1))
        share = np.clip((levels - low) / np.maximum(high - low, np.finfo(np.float64).tiny), 0.0, 1.0)
        # The root of b t + (a - b) t^2 / 2 = share (b + a) / 2, before and after, in the form that does not cancel.
        root = before + np.sqrt(before**2 + (after**2 - before**2) * share)
        part = np.divide(share * (before + after), root, out=share.copy(), where=root > 0)
        return cell, part


def densities(grids: Floats, log_density: Floats) -> Densities:
    """Densities from their logarithms at the nodes of increasing grids, both (densities, grid), up to a constant."""
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
    return Densities(grids, density / total, below / total)
