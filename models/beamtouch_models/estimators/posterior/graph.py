"""The posterior of a contact as an ONNX graph: no training, a few dozen operations, an error at the accuracy limit.

z is the sample and W its whitening, in which a missing channel is a zero row and column. The cells i = 1..N of the
position range have width w_i, share s_i of the range, and influence g_i at their middles.

    y = W z / sqrt(2)      H_i = W g_i / sqrt(2)      a_i = |H_i|^2           products over the channels
    f_i = clip(H_i . y / a_i, 0, F)                                           best force of a cell
    R_i = |y - f_i H_i|^2                                                     half misfit, no difference of squares
    m_i = mean of exp(-a_i (f - f_i)^2) over the prior of the force           a sum of normal distribution functions
    p_i ~ s_i m_i exp(-R_i)                    C_i = p_1 + .. + p_(i-1)       posterior over the cells
    x_q = x_0 + sum_i w_i clip((q - C_i) / p_i, 0, 1)                         quantiles, linear within a cell

*Force.* Its prior is even over the range of the scene, or a single known force, with a hundredth of the mass in tails
from 0 to 10 times the largest force (`accuracy.forces`). A force beyond the range gets its true place.

*Interval.* If the force is open, the interval comes from a second posterior, with a prior of the force that leans on
neither end of the range (`accuracy.forces`): it holds the truth also just outside the range, where the first prior
pulls the position towards a place that a force within the range explains. Both weight the same normal distribution
functions. Each quantile has a row of its own, and the interval reaches to the median, which keeps the first prior.

*Log odds.* log(sum_i s_i exp(-R_i)) + |y|^2, without the prior of the force: at rest their distribution depends
only on the directions of the influence, not on the size of the covariance.

*Misfit.* The smallest 2 R over the position: a parabola through the best three cells, which are neighbours. For a
single contact it is chi-square distributed, with two degrees of freedom less than there are channels. One or two
channels have a misfit only for a sample outside the cone of all contacts, such as a pull.

Where even many cells would be wider than the posterior, the cells lie around the contact, as `window` says.
"""

import numpy as np
import onnx

from beamtouch_models.accuracy.prior import Prior
from beamtouch_models.estimators.onnx_graph import Graph, model
from beamtouch_models.estimators.posterior.answers import Grid, state_answers
from beamtouch_models.estimators.posterior.cells import cells_of, resolving_cells
from beamtouch_models.estimators.posterior.scoring import lowest_of, scored, whitened
from beamtouch_models.estimators.posterior.window import scan, table_of, windowed_graph


def posterior_graph(prior: Prior, *, with_force: bool, finest: Prior | None = None) -> onnx.ModelProto:
    """Return the ONNX graph of a prior, without metadata.

    `finest` has the least noise that samples have, which the cells must resolve; by default that of the prior.
    """
    finest = finest or prior
    count = resolving_cells(finest)
    if count is not None:
        return fixed_cells_graph(prior, count, with_force=with_force)
    table = table_of(finest)
    return windowed_graph(prior, table, scan(prior, table), with_force=with_force)


def fixed_cells_graph(prior: Prior, count: int, *, with_force: bool) -> onnx.ModelProto:
    """Return the graph on `count` cells that are the same for every sample."""
    graph, cells, largest_n = Graph(), cells_of(prior, count), prior.force_n[1]
    uncertain = None if cells.uncertain is None else graph.constant(cells.uncertain.T**2)
    seen = whitened(graph, prior.largest_mm)
    found = scored(graph, seen, largest_n, graph.constant(cells.influence.T), uncertain)
    lowest = lowest_of(graph, found.misfit)
    # Rounding may put the bottom below 0.
    graph.apply("ReduceL1", lowest.twice, axes=[1, 2], keepdims=0, output="misfit")
    width = np.diff(cells.edges_mm)
    share = np.maximum(width / width.sum(), np.finfo(np.float32).tiny)
    grid = Grid(graph.constant(width), graph.constant(share), float(cells.edges_mm[0]))
    outputs = state_answers(graph, prior, found, lowest.cell, grid, with_force=with_force)
    return model(graph, prior.channels, outputs)
