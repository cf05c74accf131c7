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
from beamtouch_models.metadata import INPUTS

RESOLVED = 0.5
"""Largest cell, in deviations, that is not tempered, for a known force."""
CENTRE_ERROR = {True: 0.004, False: 0.026}
"""For known and open force: error of a tempered posterior's centre, in units of its widened deviation; it widens the
interval."""
MOST_TURNED = 0.01
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

    def contraction(self, posterior: str) -> str:
        """Return rho^2, (batch, 1, 1)."""
        graph = self.graph
        rho2 = graph.apply("ReduceSum", graph.apply("Div", posterior, self.widening), graph.ints(2), keepdims=1)
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


def tempered(graph: Graph, prior: Prior, cells: Cells, sample: str, shape: str, precision: str) -> Tempered:
    """Return the widening of each cell, from the change of the reading across it."""
    known = prior.force_is_known
    crossed = cells.change.T * (prior.force_n[1] if known else 1.0)
    change = graph.apply("MatMul", INPUTS[1], graph.constant(crossed))
    if known:
        step2 = graph.apply("ReduceSumSquare", change, axes=[1], keepdims=1)
        step2 = graph.apply("Max", graph.apply("Sub", step2, graph.constant(RESOLVED**2)), graph.constant(0.0))
    else:
        # A change along the deflection itself is one of the force; the rest turns the reading.
        along = graph.apply("ReduceSum", graph.apply("Mul", change, shape), graph.ints(1), keepdims=1)
        along = graph.apply("Mul", graph.apply("Div", along, precision), shape)
        turned = graph.apply("ReduceSumSquare", graph.apply("Sub", change, along), axes=[1], keepdims=1)
        size = graph.apply("ReduceSumSquare", sample, axes=[1], keepdims=1)
        turned = graph.apply("Min", graph.apply("Div", turned, precision), graph.constant(MOST_TURNED))
        step2 = graph.apply("Mul", turned, size)
    # Slightly more than t, so that rho^2 including the error of the centre is at most 1.
    error = CENTRE_ERROR[known]
    unit = graph.constant(1 / (1 - error**2))
    widening = graph.apply("Add", graph.apply("Mul", step2, unit), unit)
    return Tempered(graph, cells, widening, error)
