"""Tempering: the posterior graph where the cells are wider than the posterior, as at 0.01 % noise on perfect sensors.

Dividing the log likelihood of a cell by t_i = 1 + (its width in deviations)^2 widens the posterior to about a cell. Its
centre stays right, because the sum of a Gaussian over equidistant points is right to 1e-8 if its deviation is at least
their distance. Then the quantiles are contracted about the median by rho, rho^2 = sum_i p_i / t_i, which restores the
width. Where cells resolve the posterior, as at the ends of the beam, t is 1.
"""

from dataclasses import dataclass

import numpy as np

from beamtouch_models.accuracy.prior import Prior
from beamtouch_models.estimators.onnx_graph import Graph
from beamtouch_models.estimators.posterior.cells import Cells
from beamtouch_models.estimators.posterior.scoring import Scored
from beamtouch_models.metadata import INPUTS

RESOLVED = 0.5
"""Largest cell, in deviations, that is not tempered, for a known force."""
CENTRE_ERROR = {True: 0.004, False: 0.026}
"""For known and open force: error of a tempered posterior's centre, in units of its widened deviation; it widens the
interval."""
MAX_TURNED = 0.01
"""Largest square of the angle by which a cell turns the reading; next to a support it is noise."""
NARROW = 2.0
"""Largest deviation of a posterior, in cells, for which its mean is its centre."""


@dataclass(frozen=True)
class Tempered:
    """The widening of each cell's likelihood."""

    graph: Graph
    cells: Cells
    widening: str
    """t, (batch, 1, N)"""
    centre_error: float
    """Error of the centre, in units of the widened deviation."""
    turning: str = ""
    """t of the tails of a known force, (batch, 1, N)."""
    change: str = ""
    """Change of the whitened reading across each cell under a known force, (batch, channels, N)."""

    def contraction(self, posterior: str, other: str | None = None) -> str:
        """Return rho^2, (batch, 1, 1); `other` is the part of each cell that the tails of a known force have."""
        graph = self.graph
        narrowed = graph.apply("Reciprocal", self.widening)
        if other is not None:
            turned = graph.apply("Sub", graph.apply("Reciprocal", self.turning), narrowed)
            narrowed = graph.apply("Add", narrowed, graph.apply("Mul", other, turned))
        rho2 = graph.apply("ReduceSum", graph.apply("Mul", posterior, narrowed), graph.ints(2), keepdims=1)
        return graph.apply("Add", rho2, graph.constant(self.centre_error**2))

    def centre(self, posterior: str, median: str) -> str:
        """Return the mean where a posterior is as narrow as its tempering allows, the median elsewhere.

        Both are double, from the left end of the range.

        A median that is linear within its cell is off by up to a hundredth of the cell, which is more than a narrow
        posterior is wide before it is tempered. The mean of such a posterior has the error of a sum of a Gaussian.
        """
        graph, axis = self.graph, self.graph.ints(2)

        def mean_of(values: str) -> str:
            return graph.apply("ReduceSum", graph.apply("Mul", shares, values), axis, keepdims=1)

        shares = graph.cast(posterior, np.float64)
        shares = graph.apply("Div", shares, graph.apply("ReduceSum", shares, axis, keepdims=1))
        middle = graph.constant(self.cells.middles_mm - self.cells.edges_mm[0], np.float64)
        mean = mean_of(middle)
        off = graph.apply("Sub", middle, mean)
        cell = mean_of(graph.constant((NARROW * np.diff(self.cells.edges_mm)) ** 2, np.float64))
        narrow = graph.apply("Less", mean_of(graph.apply("Mul", off, off)), cell)
        narrow, mean = (graph.apply("Squeeze", value, axis) for value in (narrow, mean))
        return graph.apply("Where", narrow, mean, median)


def tempered(graph: Graph, prior: Prior, cells: Cells, found: Scored) -> Tempered:
    """Return the widening of each cell, from the change of the reading across it."""
    crossed = cells.change.T * (prior.force_n[1] if prior.force_is_known else 1.0)
    change = graph.apply("MatMul", INPUTS[1], graph.constant(crossed))
    # Of a change along the deflection itself a force makes up; the rest turns the reading.
    along = graph.apply("ReduceSum", graph.apply("Mul", change, found.shape), graph.ints(1), keepdims=1)
    along = graph.apply("Mul", graph.apply("Div", along, found.precision), found.shape)
    turned = graph.apply("ReduceSumSquare", graph.apply("Sub", change, along), axes=[1], keepdims=1)
    if not prior.force_is_known:
        size = graph.apply("ReduceSumSquare", found.sample, axes=[1], keepdims=1)
        turned = graph.apply("Min", graph.apply("Div", turned, found.precision), graph.constant(MAX_TURNED))
        error = CENTRE_ERROR[False]
        return Tempered(graph, cells, _widening(graph, graph.apply("Mul", turned, size), error), error)
    error = CENTRE_ERROR[True]
    step2 = graph.apply("ReduceSumSquare", change, axes=[1], keepdims=1)
    # A cell is turned by as much more as its force is more than the known one.
    part = graph.apply("Div", found.force, graph.constant(prior.force_n[1]))
    turned = graph.apply("Mul", turned, graph.apply("Mul", part, part))
    step2, turned = (
        graph.apply("Max", graph.apply("Sub", square, graph.constant(RESOLVED**2)), graph.constant(0.0))
        for square in (step2, turned)
    )
    return Tempered(graph, cells, _widening(graph, step2, error), error, _widening(graph, turned, error), change)


def _widening(graph: Graph, step2: str, centre_error: float) -> str:
    """Return t: slightly more than 1 + step^2, so that rho^2 including the error of the centre is at most 1."""
    unit = graph.constant(1 / (1 - centre_error**2))
    return graph.apply("Add", graph.apply("Mul", step2, unit), unit)
