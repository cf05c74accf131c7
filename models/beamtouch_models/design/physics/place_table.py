"""Values over the places of an extent: a grid of them, and cubic splines between its nodes."""

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Self

import numpy as np
from scipy.interpolate import BSpline, CubicSpline, NdBSpline, make_interp_spline

from beamtouch_models.arrays import Floats, Indices
from beamtouch_models.places import Extent, grid_of

NODES = {1: 2001, 2: 64**2}
"""Number of nodes, by the number of axes."""
DEGREE = 3
"""Of the splines."""


class PlaceTable:
    """Values (places, columns) of a function of places, such as the influence on each channel.

    The influence of a beam is off by at most 2e-6 of its largest value for any shipped scene, and by 3e-5 right at a
    sensor under a beam with shear, which has a kink there.

    >>> table = PlaceTable.over(Extent(((0, 4), (0, 2))), lambda place: place[:, :1] * place[:, 1:])
    >>> table(np.array([[3, 1.5]])).round(9), table.slope(np.array([[3, 1.5]])).round(9)
    (array([[4.5]]), array([[[1.5, 3. ]]]))
    """

    def __init__(self, ticks_mm: Sequence[Floats], values: Floats, least: float = -np.inf) -> None:
        """Take the values (nodes, columns) at all places with these coordinates along each axis, as `grid_of` orders.

        No value between them is below `least`.
        """
        self._least = least
        self._ticks = list(ticks_mm)
        self.values = values
        """(nodes, columns)"""

    @classmethod
    def over(cls, extent: Extent, values_at: Callable[[Floats], Floats], least: float = -np.inf) -> Self:
        """Compute the values at the nodes of an even grid over an extent; `values_at` takes places (places, axes)."""
        ticks = extent.ticks(NODES[extent.axes])
        return cls(ticks, values_at(grid_of(ticks)), least)

    def __call__(self, place_mm: Floats) -> Floats:
        """Return the values at places (..., axes), (..., columns)."""
        values: Floats = self._line(place_mm[..., 0]) if len(self._ticks) == 1 else self._surface(place_mm)
        return values if self._least == -np.inf else np.maximum(values, self._least)

    def on_grids(self, ticks_mm: Sequence[Floats]) -> Floats:
        """Return the values on grids, (grids, places, columns), each in the order of `grid_of`.

        `ticks_mm` are the coordinates along each of two axes, arrays (grids, ticks).
        """
        surface = self._surface
        (across, first), (beside, second) = (
            _basis(ticks, knots) for ticks, knots in zip(ticks_mm, surface.t, strict=True)
        )
        # Of the nodes, only those that a grid needs.
        near: Floats = surface.c[first[:, :, None], second[:, None, :]]
        grids, nodes, others, columns = near.shape
        along, over = (len(weights[0]) for weights in (across, beside))
        rows = across @ near.reshape(grids, nodes, others * columns)
        rows = rows.reshape(grids, along, others, columns).swapaxes(1, 2)
        values = beside @ rows.reshape(grids, others, along * columns)
        values = values.reshape(grids, over, along, columns).swapaxes(1, 2)
        values = values.reshape(grids, along * over, columns)
        return values if self._least == -np.inf else np.maximum(values, self._least)

    def slope(self, place_mm: Floats) -> Floats:
        """Return the change with each axis at places (places, axes), (places, columns, axes) per mm."""
        if len(self._ticks) == 1:
            return np.asarray(self._line(place_mm[:, 0], 1)[..., None])
        return np.stack([self._surface(place_mm, nu=tuple(axis)) for axis in np.eye(len(self._ticks), dtype=int)], -1)

    @cached_property
    def _line(self) -> CubicSpline:  # of one axis; three times as fast as the same spline of any number of axes
        (along,) = self._ticks
        return CubicSpline(along, self.values)

    @cached_property
    def _surface(self) -> NdBSpline:
        knots, values = [], self.values.reshape(*map(len, self._ticks), -1)
        for axis, ticks in enumerate(self._ticks):
            spline = make_interp_spline(ticks, np.moveaxis(values, axis, 0))
            knots.append(spline.t)
            values = np.moveaxis(spline.c, 0, axis)
        return NdBSpline(tuple(knots), values, DEGREE)


def _basis(ticks_mm: Floats, knots: Floats) -> tuple[Floats, Indices]:
    """Return the weights (grids, ticks, nodes) of nodes at ticks (grids, ticks), and these nodes (grids, nodes)."""
    basis = BSpline.design_matrix(ticks_mm.ravel(), knots, DEGREE)
    shape = (*ticks_mm.shape, DEGREE + 1)
    node, weight = basis.indices.reshape(shape), basis.data.reshape(shape)
    first = node.min(axis=(1, 2))
    away = node - first[:, None, None]
    weights = np.zeros((*ticks_mm.shape, int(away.max()) + 1))
    np.put_along_axis(weights, away, weight, axis=2)
    nodes = np.minimum(first[:, None] + np.arange(weights.shape[2]), basis.shape[1] - 1)
    return weights, nodes
