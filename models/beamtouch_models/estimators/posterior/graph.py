"""The posterior of a contact as an ONNX graph: no training, a few dozen operations, an error at the accuracy limit.

z is the sample and W its whitening, in which a missing channel is a zero row and column. The cells i = 1..N of the
position range have width w_i, share s_i of the range, and influence g_i at their middles.

    y = W z / sqrt(2)      H_i = W g_i / sqrt(2)      a_i = |H_i|^2           products over the channels
    f_i = clip(H_i . y / a_i, 0, F)                                           best force of a cell
    R_i = |y - f_i H_i|^2                                                     half misfit, no difference of squares
    m_i = mean of exp(-a_i (f - f_i)^2) over the prior of the force           a sum of normal distribution functions
    p   = softmax(log(s_i m_i) - R_i)          C_i = p_1 + .. + p_(i-1)       posterior over the cells
    x_q = x_0 + sum_i w_i clip((q - C_i) / p_i, 0, 1)                         quantiles, linear within a cell

*Force.* Its prior is even over the range of the scene, or a single known force, with a hundredth of the mass in tails
from 0 to 10 times the largest force (`accuracy.forces`). A force beyond the range gets its true place.

*Interval.* If the force is open, the interval comes from a second posterior, with an even prior of the force from 0 to
10 times the largest: it holds the truth also just outside the range, where the first prior pulls the position towards
a place that a force within the range explains. The median keeps the first prior, but stays between
the 5 % and 95 % quantiles of the second.

*Log odds.* log(sum_i s_i exp(-R_i)) + |y|^2, without the prior of the force: at rest their distribution depends
only on the directions of the influence, not on the size of the covariance.

*Misfit.* The smallest 2 R over the position: a parabola through the best cell and its neighbours. For a single contact
it is chi-square distributed, with two degrees of freedom less than there are channels.

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
from beamtouch_models.estimators.posterior.force import log_mass, state_force
from beamtouch_models.estimators.posterior.tempering import Tempered, tempered
from beamtouch_models.metadata import FORCE_OUTPUTS, INPUTS, POSITION_OUTPUTS

QUANTILES = (0.5, 0.025, 0.975, 0.05, 0.95)
"""Of the first posterior, the median; of the second, the ends of the interval and those that keep the median in it."""
LEAST_PRECISION = np.pi / HIGHEST**2
"""Added to a, over the square of the largest force: then 1 / sqrt(a) is the mass of an even prior up to HIGHEST, even
in a cell that says nothing of the force."""
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
    """Log of the factor by which the mounting of the sensors widens the errors; None if it does not."""


def posterior_graph(prior: Prior, *, with_force: bool, design: Design | None = None) -> onnx.ModelProto:
    """Return the ONNX graph of a prior, without metadata; `design` replaces the default for the prior."""
    design = design or design_for(prior)
    graph, cells = Graph(), cells_of(prior, design.cells)
    scored = _scored(graph, prior, cells)
    widened = None
    if design.temper:
        widened = tempered(graph, prior, cells, scored.sample, scored.shape, scored.precision)
    root = graph.apply("Sqrt", scored.precision)
    mass = log_mass(graph, prior.force_n, root, scored.force, widened.widening if widened else None)
    width = np.diff(cells.edges_mm)
    share = graph.constant(np.log(np.maximum(width / width.sum(), np.finfo(np.float32).tiny)))
    weighted = graph.apply("Sub", share, scored.misfit)
    if scored.widened is not None:
        mass = graph.apply("Sub", mass, scored.widened)
    _log_odds(graph, scored, weighted)
    if widened is not None:
        weighted = graph.apply("Sub", share, graph.apply("Div", scored.misfit, widened.widening))
    posterior = _posteriors(graph, prior, weighted, mass, scored)
    contraction = None if widened is None else widened.contraction(posterior)
    _state_position(graph, prior, cells, posterior, widened, contraction)
    _state_misfit(graph, scored, prior.channels, design.cells)
    outputs = list(POSITION_OUTPUTS)
    if with_force:
        state_force(graph, prior.force_n, scored.precision, root, scored.force, posterior, contraction)
        outputs += FORCE_OUTPUTS
    return model(graph, prior.channels, outputs)


def _posteriors(graph: Graph, prior: Prior, weighted: str, mass: str, scored: Scored) -> str:
    """Return the posteriors of the median and of the interval, (batch, 2, N); a single one if the force is known."""
    score = graph.apply("Add", weighted, mass)
    if not prior.force_is_known:
        ends = graph.apply("Mul", graph.apply("Log", scored.precision), graph.constant(-0.5))
        ends = graph.apply("Add", weighted, ends)
        if scored.widened is not None:
            ends = graph.apply("Sub", ends, scored.widened)
        score = graph.apply("Concat", score, ends, axis=1)
    every = graph.apply("Softmax", score, axis=2)
    return graph.apply("Max", every, graph.constant(SMALLEST_MASS))


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
    found = _fitted(graph, graph.apply("Div", sample, wider), shape, largest)
    density = graph.apply("ReduceSum", graph.apply("Log", wider), graph.ints(1), keepdims=1)
    return Scored(sample, shape, *found, density)


def _fitted(graph: Graph, sample: str, shape: str, largest_n: float) -> tuple[str, str, str]:
    """Return precision, best force and half the misfit of each cell."""
    along = graph.apply("ReduceSum", graph.apply("Mul", shape, sample), graph.ints(1), keepdims=1)
    precision = graph.apply("ReduceSumSquare", shape, axes=[1], keepdims=1)
    precision = graph.apply("Add", precision, graph.constant(LEAST_PRECISION / largest_n**2))
    force = graph.apply("Div", along, precision)
    force = graph.apply("Clip", force, graph.constant(0.0), graph.constant(HIGHEST * largest_n))
    residual = graph.apply("Sub", sample, graph.apply("Mul", force, shape))
    return precision, force, graph.apply("ReduceSumSquare", residual, axes=[1], keepdims=1)


def _log_odds(graph: Graph, scored: Scored, weighted: str) -> None:
    """Add the log odds of contact; `weighted` is log s_i - R_i."""
    touched = graph.apply("ReduceLogSumExp", weighted, axes=[1, 2], keepdims=0)
    rest = graph.apply("ReduceSumSquare", scored.sample, axes=[1, 2], keepdims=0)
    graph.apply("Add", touched, rest, output="contact_log_odds")


def _state_position(
    graph: Graph, prior: Prior, cells: Cells, posterior: str, widened: Tempered | None, contraction: str | None
) -> None:
    """Add median and interval from the posteriors over the cells, contracted about their medians if tempered."""
    many = len(cells.middles_mm) > EXACT_SUMS
    kind = np.float64 if many else np.float32
    before = graph.apply("CumSum", posterior, graph.index(2), exclusive=1)
    known = prior.force_is_known
    rows, levels = graph.ints(*([0] * 3 if known else [0, 1, 1, 1, 1])), QUANTILES[:3] if known else QUANTILES
    if not known:
        posterior, before = (graph.apply("Gather", one, rows, axis=1) for one in (posterior, before))
    place = _quantile(graph, cells, posterior, before, levels, kind)
    if widened is not None and contraction is not None:
        median = _quantile(graph, cells, posterior, before, (0.5,) * len(levels), kind)
        centre = widened.centre(posterior, median, cells) if many else median
        part = graph.apply("Sqrt", graph.apply("Squeeze", contraction, graph.ints(2)))
        part = graph.apply("Gather", part, rows, axis=1)
        part = graph.cast(part, kind) if many else part
        place = graph.apply("Add", centre, graph.apply("Mul", graph.apply("Sub", place, median), part))
    place = graph.cast(place, np.float32) if many else place
    names = (POSITION_OUTPUTS[0] if known else None, *POSITION_OUTPUTS[1:3], None, None)[: len(levels)]
    found = [graph.apply("Gather", place, graph.index(i), axis=1, output=name) for i, name in enumerate(names)]
    if not known:
        middle = graph.apply("Max", found[0], found[3])
        graph.apply("Min", middle, found[4], output=POSITION_OUTPUTS[0])


def _quantile(
    graph: Graph, cells: Cells, posterior: str, before: str, levels: tuple[float, ...], kind: DTypeLike
) -> str:
    """Return a quantile of each posterior, (batch, 5)."""
    part = graph.apply("Sub", graph.constant(np.array(levels).reshape(1, -1, 1)), before)
    part = graph.apply("Clip", graph.apply("Div", part, posterior), graph.constant(0.0), graph.constant(1.0))
    along = graph.apply("Mul", part, graph.constant(np.diff(cells.edges_mm)))
    # A matrix-vector product of the built-in kernels would be three times slower.
    place = graph.apply(
        "ReduceSum", graph.cast(along, kind) if kind == np.float64 else along, graph.ints(2), keepdims=0
    )
    return graph.apply("Add", place, graph.constant(cells.edges_mm[0], kind)) if cells.edges_mm[0] else place


def _state_misfit(graph: Graph, scored: Scored, channels: int, cells: int) -> None:
    """Add the smallest misfit over the position, from a parabola through the best cell and its neighbours.

    Two channels or fewer fit any contact, so that there is nothing to misfit.
    """
    axes = graph.ints(1, 2)
    if channels <= 2:
        least = graph.apply("ReduceSum", scored.misfit, axes, keepdims=0)
        graph.apply("Mul", least, graph.constant(0.0), output="misfit")
        return
    best = graph.apply("Add", graph.apply("ArgMin", scored.misfit, axis=2, keepdims=1), graph.ints(-1, 0, 1))
    # Beyond the ends of the range the end itself is repeated: its parabola is lowest at the edge of the cell.
    best = graph.apply("Clip", best, graph.index(0), graph.index(cells - 1))
    three = graph.apply("GatherElements", scored.misfit, best, axis=2)
    # Value, slope and curvature, scaled so that the parabola is lowest at value - slope^2 / curvature.
    parabola: Floats = np.array([[0.0, -0.5, 1.0], [2.0, 0.0, -2.0], [0.0, 0.5, 1.0]])
    value, slope, curvature = graph.split(graph.apply("MatMul", three, graph.constant(parabola)), 3, 2)
    curvature = graph.apply("Max", curvature, graph.constant(SMALLEST_MASS))
    drop = graph.apply("Div", graph.apply("Mul", slope, slope), curvature)
    lowest = graph.apply("Max", graph.apply("Sub", value, drop), graph.constant(0.0))
    graph.apply("Squeeze", lowest, axes, output="misfit")
