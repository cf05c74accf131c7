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
single contact it is chi-square distributed, with two degrees of freedom less than there are channels.

Where cells are wider than the posterior, `tempering` widens the likelihood and contracts the quantiles again.
"""

from dataclasses import dataclass

import numpy as np
import onnx
from numpy.typing import DTypeLike

from beamtouch_models.accuracy.forces import HIGHEST
from beamtouch_models.accuracy.prior import Prior
from beamtouch_models.arrays import Floats
from beamtouch_models.estimators.onnx_graph import Graph, model
from beamtouch_models.estimators.posterior.cells import Cells, Design, cells_of, design_for
from beamtouch_models.estimators.posterior.force import mass_of, state_force, state_known_force
from beamtouch_models.estimators.posterior.tempering import Tempered, tempered
from beamtouch_models.metadata import FORCE_OUTPUTS, INPUTS, POSITION_OUTPUTS

QUANTILES = (0.5, 0.025, 0.975)
"""The median, and the ends of the interval."""
LEAST_PRECISION = np.pi / HIGHEST**2
"""Added to a, over the square of the largest force: a cell that says nothing of the force has a best force, too."""
EXACT_SUMS = 512
"""Number of cells above which a sum of widths in float32 loses a digit of the interval."""
WIDEST = 1e4
"""Samples are clipped to this multiple of the largest deflection, so that nothing overflows."""
SMALLEST_MASS = 1e-26
"""Keeps the place within an empty cell finite, and avoids subnormal numbers, which are slow."""


@dataclass(frozen=True)
class Scored:
    """Names of results, (batch, 1, N) unless stated otherwise."""

    sample: str
    """y, (batch, channels, 1)"""
    shape: str
    """H, (batch, channels, N)"""
    precision: str
    """a"""
    force: str
    """f"""
    misfit: str
    """R, half the misfit"""
    widened: str | None
    """Factor by which the mounting of the sensors widens the errors; None if it does not."""


def posterior_graph(prior: Prior, *, with_force: bool, design: Design | None = None) -> onnx.ModelProto:
    """Return the ONNX graph of a prior, without metadata; `design` replaces the default for the prior."""
    design = design or design_for(prior)
    graph, cells = Graph(), cells_of(prior, design.cells)
    scored = _scored(graph, prior, cells)
    widened = None
    if design.temper:
        widened = tempered(graph, prior, cells, scored.sample, scored.shape, scored.precision)
    root = graph.apply("Sqrt", scored.precision)
    mass = mass_of(graph, prior.force_n, root, scored.force, widened.widening if widened else None)
    least = _state_misfit(graph, scored, prior.channels)
    width = np.diff(cells.edges_mm)
    share = graph.constant(np.maximum(width / width.sum(), np.finfo(np.float32).tiny))
    # Sums of exponentials and their logarithm take less time than the operations that do both.
    exponent = graph.apply("Sub", least, scored.misfit)
    likely = graph.apply("Mul", graph.apply("Exp", exponent), share)
    _state_log_odds(graph, scored, likely, least)
    if widened is not None:
        exponent = graph.apply("Div", exponent, widened.widening)
        likely = graph.apply("Mul", graph.apply("Exp", exponent), share)
    if scored.widened is not None:
        likely = graph.apply("Div", likely, scored.widened)
    posterior = graph.apply("Mul", likely, mass)
    posterior = graph.apply("LpNormalization", posterior, axis=2, p=1)
    posterior = graph.apply("Max", posterior, graph.constant(SMALLEST_MASS))
    contraction = None if widened is None else widened.contraction(posterior)
    _state_position(graph, cells, posterior, widened, contraction)
    outputs = list(POSITION_OUTPUTS)
    if with_force:
        if prior.force_is_known:
            state_known_force(graph, prior.force_n, root, scored.force, posterior, contraction)
        else:
            state_force(graph, prior.force_n, scored.precision, scored.force, posterior, contraction)
        outputs += FORCE_OUTPUTS
    return model(graph, prior.channels, outputs)


def _scored(graph: Graph, prior: Prior, cells: Cells) -> Scored:
    """Return the misfit of the best force of each cell."""
    deflection, given = INPUTS
    influence, largest = cells.influence.T, prior.force_n[1]
    bound = WIDEST * largest * float(np.abs(influence).max())
    whitening = graph.apply("Mul", given, graph.constant(0.5**0.5))
    reading = graph.apply("Clip", deflection, graph.constant(-bound), graph.constant(bound))
    sample = graph.apply("MatMul", whitening, graph.apply("Unsqueeze", reading, graph.ints(2)))
    shape = graph.apply("MatMul", whitening, graph.constant(influence))
    if cells.uncertain is None:
        return Scored(sample, shape, *_fitted(graph, sample, shape, largest), None)
    # The likeliest force says how much the mounting of the sensors adds to the variance of each channel.
    _, force, _ = _fitted(graph, sample, shape, largest)
    weight = graph.apply("Mul", given, given)
    moved = graph.apply("MatMul", weight, graph.constant(cells.uncertain.T**2))
    moved = graph.apply("Mul", moved, graph.apply("Mul", force, force))
    wider = graph.apply("Sqrt", graph.apply("Add", moved, graph.constant(1.0)))
    shape = graph.apply("Div", shape, wider)
    found = _fitted(graph, graph.apply("Div", sample, wider), shape, largest, own=True)
    return Scored(sample, shape, *found, graph.apply("ReduceProd", wider, axes=[1], keepdims=1))


def _fitted(graph: Graph, sample: str, shape: str, largest_n: float, *, own: bool = False) -> tuple[str, str, str]:
    """Return precision, best force and half the misfit of each cell; `own`: each cell has its own sample."""
    if own:
        along = graph.apply("ReduceSum", graph.apply("Mul", shape, sample), graph.ints(1), keepdims=1)
    else:
        along = graph.apply("MatMul", graph.apply("Transpose", sample, perm=[0, 2, 1]), shape)
    precision = graph.apply("ReduceSumSquare", shape, axes=[1], keepdims=1)
    precision = graph.apply("Add", precision, graph.constant(LEAST_PRECISION / largest_n**2))
    force = graph.apply("Div", along, precision)
    force = graph.apply("Clip", force, graph.constant(0.0), graph.constant(HIGHEST * largest_n))
    residual = graph.apply("Sub", sample, graph.apply("Mul", force, shape))
    return precision, force, graph.apply("ReduceSumSquare", residual, axes=[1], keepdims=1)


def _state_log_odds(graph: Graph, scored: Scored, likely: str, least: str) -> None:
    """Add the log odds of contact; `likely` is s_i exp(least R - R_i)."""
    axes = graph.ints(1, 2)
    touched = graph.apply("Log", graph.apply("ReduceSum", likely, axes, keepdims=1))
    rest = graph.apply("ReduceSumSquare", scored.sample, axes=[1, 2], keepdims=1)
    odds = graph.apply("Add", touched, graph.apply("Sub", rest, least))
    graph.apply("Squeeze", odds, axes, output="contact_log_odds")


def _state_position(
    graph: Graph, cells: Cells, posterior: str, widened: Tempered | None, contraction: str | None
) -> None:
    """Add median and interval from the posteriors over the cells, contracted about their medians if tempered."""
    many = len(cells.middles_mm) > EXACT_SUMS
    kind = np.float64 if many else np.float32
    before = graph.apply("CumSum", posterior, graph.index(2), exclusive=1)
    place = _quantile(graph, cells, posterior, before, QUANTILES, kind)
    if widened is not None and contraction is not None:
        median = _quantile(graph, cells, posterior, before, (0.5,) * len(QUANTILES), kind)
        centre = widened.centre(posterior, median, cells) if many else median
        part = graph.apply("Sqrt", graph.apply("Squeeze", contraction, graph.ints(2)))
        part = graph.cast(part, kind) if many else part
        place = graph.apply("Add", centre, graph.apply("Mul", graph.apply("Sub", place, median), part))
    place = graph.cast(place, np.float32) if many else place
    place = graph.apply("Add", place, graph.constant(cells.edges_mm[0])) if cells.edges_mm[0] else place
    graph.apply("Gather", place, graph.index(0), axis=1, output=POSITION_OUTPUTS[0])
    graph.apply("ReduceMin", place, axes=[1], keepdims=0, output=POSITION_OUTPUTS[1])
    graph.apply("ReduceMax", place, axes=[1], keepdims=0, output=POSITION_OUTPUTS[2])


def _quantile(
    graph: Graph, cells: Cells, posterior: str, before: str, levels: tuple[float, ...], kind: DTypeLike
) -> str:
    """Return a quantile of each posterior, (batch, 3), from the left end of the range."""
    part = graph.apply("Sub", graph.constant(np.array(levels).reshape(1, -1, 1)), before)
    part = graph.apply("Clip", graph.apply("Div", part, posterior), graph.constant(0.0), graph.constant(1.0))
    along = graph.apply("Mul", part, graph.constant(np.diff(cells.edges_mm)))
    # A matrix-vector product of the built-in kernels would be three times slower.
    return graph.apply("ReduceSum", graph.cast(along, kind) if kind == np.float64 else along, graph.ints(2), keepdims=0)


def _state_misfit(graph: Graph, scored: Scored, channels: int) -> str:
    """Add the smallest misfit over the position, from a parabola through the best cell and its neighbours.

    Two channels or fewer fit any contact, so that there is nothing to misfit. Returns the least R of a cell.
    """
    if channels <= 2:
        least = graph.apply("ReduceMin", scored.misfit, axes=[1, 2], keepdims=1)
        graph.apply("Mul", graph.apply("Squeeze", least, graph.ints(1, 2)), graph.constant(0.0), output="misfit")
        return least
    three = graph.top(scored.misfit, 3, 2, largest=False)
    # R, misfit, slope and curvature, scaled so that the parabola is lowest at misfit - slope^2 / curvature.
    parabola: Floats = np.array([[1.0, 2.0, 0.0, -2.0], [0.0, 0.0, -0.5, 1.0], [0.0, 0.0, 0.5, 1.0]])
    least, value, slope, curvature = graph.split(graph.apply("MatMul", three, graph.constant(parabola)), 4, 2)
    curvature = graph.apply("Max", curvature, graph.constant(SMALLEST_MASS))
    drop = graph.apply("Div", graph.apply("Mul", slope, slope), curvature)
    # Rounding may put the bottom below 0.
    graph.apply("ReduceL1", graph.apply("Sub", value, drop), axes=[1, 2], keepdims=0, output="misfit")
    return least
