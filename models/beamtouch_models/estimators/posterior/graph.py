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

Where cells are wider than the posterior, `tempering` widens the likelihood and contracts the quantiles again. A known
force and its tails are widened apart, as `known_force` says.
"""

import numpy as np
import onnx

from beamtouch_models.accuracy.prior import Prior
from beamtouch_models.estimators.onnx_graph import Graph, model
from beamtouch_models.estimators.posterior.answers import Grid, state_answers
from beamtouch_models.estimators.posterior.cells import Design, cells_of, design_for
from beamtouch_models.estimators.posterior.scoring import lowest_of, scored, whitened
from beamtouch_models.estimators.posterior.tempering import tempered

EXACT_SUMS = 512
"""Number of cells above which a sum of widths in float32 loses a digit of the interval."""


def posterior_graph(prior: Prior, *, with_force: bool, design: Design | None = None) -> onnx.ModelProto:
    """Return the ONNX graph of a prior, without metadata; `design` replaces the default for the prior."""
    design = design or design_for(prior)
    graph, cells, largest_n = Graph(), cells_of(prior, design.cells), prior.force_n[1]
    uncertain = None if cells.uncertain is None else graph.constant(cells.uncertain.T**2)
    seen = whitened(graph, largest_n * float(np.abs(cells.influence).max()))
    found = scored(graph, seen, largest_n, graph.constant(cells.influence.T), uncertain)
    widened = tempered(graph, prior, cells, found) if design.temper else None
    lowest = lowest_of(graph, found.misfit)
    # Rounding may put the bottom below 0.
    graph.apply("ReduceL1", lowest.twice, axes=[1, 2], keepdims=0, output="misfit")
    width = np.diff(cells.edges_mm)
    share = np.maximum(width / width.sum(), np.finfo(np.float32).tiny)
    kind = np.float64 if design.cells > EXACT_SUMS else np.float32
    grid = Grid(graph.constant(width), graph.constant(share), float(cells.edges_mm[0]), kind)
    outputs = state_answers(graph, prior, found, lowest, grid, widened, with_force=with_force)
    return model(graph, prior.channels, outputs)
