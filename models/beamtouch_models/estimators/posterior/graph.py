"""The posterior of a contact as an ONNX graph: no training, a few dozen operations, at the accuracy limit.

z is the reading with invalid channels at 0, v the validity, both over the channels; s the noise; i = 1..N the cells
of the position range, of width w_i, with influence g_i at their middles; the force F lies in [F1, F2].

    b_i = z . g_i      a_i = v . g_i^2      r = |z|^2                      products that carry the mask of channels
    y_i = clip(b_i / a_i, F1 + d_i, F2 - d_i)     d_i = s / sqrt(a_i)      best force of a cell
    R_i = r - y_i (2 b_i - y_i a_i)                                        squared misfit
    S_i = -R_i / (2 s^2 t_i) + log(w_i h_i)       t_i = 1 + k_i r / s^2    log posterior mass of a cell
    p = softmax(S)     C_i = p_1 + .. + p_(i-1)
    x_q = x_0 + sum_i w_i clip((q - C_i) / p_i, 0, 1)                      quantiles, linear within a cell

Three ideas carry it (docs/decisions/005 has the figures).

*Force.* The integral over the uniform range of the force is a difference of two normal distribution functions. A half
Gaussian in place of each of their steps, about bounds drawn in by d, needs a clip instead of two error functions and
two logarithms, and cannot underflow. h_i is the width of the force's posterior over the range's.

*Tempering.* Where noise is small a posterior is narrower than a cell. Its misfit is divided by t_i, which makes it
about a cell wide: the sum of a Gaussian over equidistant points is right to 1e-8 once its deviation is their distance,
so its centre stays right. The quantiles are then drawn in about the median by rho, rho^2 = sum_i p_i / t_i, which
gives a narrow posterior its own width back. Where cells resolve the posterior, as at the ends of the beam, t is 1.

*Rest.* Two more cells, without influence and of negligible weight, stand for a beam that nothing touches: they give the
log odds of contact, and where no contact explains the reading they take the mass and the interval is the whole range.
"""

from dataclasses import dataclass

import numpy as np
import onnx

from beamtouch_models.estimators.onnx_graph import Graph, model
from beamtouch_models.estimators.posterior.cells import Design, design_for
from beamtouch_models.estimators.posterior.tables import FIRST, REST_WEIGHT, Tables, tables_of
from beamtouch_models.modelfile import FORCE_OUTPUTS, INPUTS, POSITION_OUTPUTS
from beamtouch_models.prior import Prior

QUANTILES = (0.5, 0.025, 0.975)
NORMAL = 1.959964
"""97.5 % quantile of the normal distribution."""
BEND = -0.5
"""The square of how many deviations hold 95 % of a force falls by this times its variance over that of an even
distribution on the range: between what symmetric (beta) and one-sided distributions need; from measured coverage."""
CENTRE_ERROR = 0.026
"""Of a tempered posterior, in units of its widened deviation, where the force is open; it widens the intervals."""
WIDER = 1.06
"""The same for the square of the force's interval."""
EXACT_SUMS = 512
"""Cells from which a sum of widths in float32 loses a digit of the interval."""
NARROW = 2.0
"""Deviation of a posterior, in cells, up to which its mean is its centre."""
WIDEST = 1e4
"""Readings beyond this times the largest deflection are taken for it, so that nothing overflows."""
SMALLEST_LOG_MASS = -60.0
"""Keeps the place within a cell finite where nothing lies in it, and subnormal numbers, which are slow, away."""


@dataclass(frozen=True)
class Making:
    """A posterior graph under construction, with what it is made from."""

    prior: Prior
    design: Design
    tables: Tables
    graph: Graph

    @property
    def variance(self) -> float:
        """Square of the noise."""
        return self.prior.noise_mm**2

    def single(self, value: str) -> str:
        """Convert a result to float32 where it is double."""
        return self.graph.cast(value, np.float32) if self.design.precise else value


@dataclass(frozen=True)
class Scored:
    """Names of results, (batch, N) each."""

    score: str
    force: str | None = None
    """Best force of each cell; None where it is known."""
    widening: str | None = None
    """t."""


def posterior_graph(prior: Prior, *, with_force: bool, design: Design | None = None) -> onnx.ModelProto:
    """Return the ONNX graph of a prior, without metadata; `design` in place of the one for the prior."""
    design = design or design_for(prior)
    graph = Graph(np.float64 if design.precise else np.float32)
    making = Making(prior, design, tables_of(prior, design), graph)
    scored = (_known if prior.force_is_known else _open)(making, *_masked(making))
    graph.real = np.float32
    log_mass = graph.apply("LogSoftmax", scored.score, axis=1)
    mass = graph.apply("Exp", graph.apply("Max", log_mass, graph.constant(SMALLEST_LOG_MASS)))
    rest = graph.apply("Gather", log_mass, graph.index(0), axis=1)
    graph.apply("Sub", graph.constant(np.log(FIRST) - REST_WEIGHT), rest, output="contact_log_odds")
    rho2 = _narrowing(making, mass, scored) if design.temper else None
    _position(making, mass, rho2)
    outputs = list(POSITION_OUTPUTS)
    if with_force:
        _known_force(making, rest) if scored.force is None else _force(making, mass, scored.force, rho2)
        outputs += FORCE_OUTPUTS
    return model(graph, prior.channels, outputs)


def _masked(making: Making) -> tuple[str, str]:
    """Readings with invalid channels at 0, and the validity as numbers."""
    graph, (deflection, valid) = making.graph, INPUTS
    bound = WIDEST * making.prior.force_n[1] * float(np.abs(making.tables.influence).max())
    ends = [graph.constant(end, np.float32) for end in (0.0, -bound, bound)]
    reading = graph.apply("Clip", graph.apply("Where", valid, deflection, ends[0]), *ends[1:])
    return making.graph.cast(reading, np.float64) if making.design.precise else reading, graph.cast(valid, graph.real)


def _known(making: Making, reading: str, valid: str) -> Scored:
    """Known force: the misfit r - 2 F b + F^2 a is linear in (z, v, r), so all scores are one product."""
    graph, tables, force = making.graph, making.tables, making.prior.force_n[1]
    weights = np.concatenate([force * tables.influence, -(force**2) / 2 * tables.squares]) / making.variance
    inputs = [reading, valid]
    # Without r all scores of a reading are off by the same: it matters to the digits alone.
    if making.design.temper or making.design.precise:
        weights = np.concatenate([weights, np.full((1, weights.shape[1]), -0.5 / making.variance)])
        inputs.append(graph.apply("ReduceSumSquare", reading, axes=[1], keepdims=1))
    if making.design.temper:
        weights = weights / (1 + tables.temper)
    joined = graph.apply("Concat", *inputs, axis=1)
    score = graph.apply("Gemm", joined, graph.constant(weights), graph.constant(tables.log_weight))
    return Scored(making.single(score))


def _open(making: Making, reading: str, valid: str) -> Scored:
    """Open force; squares are in units of 2 s^2 from the first product on."""
    graph, tables, design = making.graph, making.tables, making.design
    unit = 1 / (2 * making.variance)
    tiny = graph.constant(np.full(len(tables.width_mm), 2 * unit * tables.tiny))
    b2 = graph.apply("MatMul", reading, graph.constant(2 * unit * tables.influence))
    a2 = graph.apply("Gemm", valid, graph.constant(2 * unit * tables.squares), tiny)
    at_least = graph.apply("Max", graph.apply("Div", b2, a2), graph.constant(tables.low_n))
    force = graph.apply("Min", at_least, graph.constant(tables.high_n))
    a = graph.apply("Mul", a2, graph.constant(0.5))
    score = graph.apply("Mul", force, graph.apply("Sub", b2, graph.apply("Mul", force, a)))
    widening = None
    if design.temper or design.precise:
        square = graph.apply("ReduceSumSquare", reading, axes=[1], keepdims=1)
        score = graph.apply("Sub", score, graph.apply("Mul", square, graph.constant(unit)))
        score, square = making.single(score), making.single(square) if design.temper else square
    graph.real = np.float32
    if design.temper:
        # A trace more than t, so that rho^2 with the error of the centre is at most 1.
        unit = 1 / (1 - CENTRE_ERROR**2)
        weights, least = unit / making.variance * tables.temper[None], np.full(len(tables.width_mm), unit)
        widening = graph.apply("Gemm", square, graph.constant(weights), graph.constant(least))
        score = graph.apply("Div", score, widening)
    return Scored(graph.apply("Add", score, graph.constant(tables.log_weight)), making.single(force), widening)


def _narrowing(making: Making, mass: str, scored: Scored) -> str:
    """rho^2, (batch, 1)."""
    graph, axis = making.graph, making.graph.ints(1)
    if scored.widening is None:
        share = graph.apply("Mul", mass, graph.constant(1 / (1 + making.tables.temper)))
        return graph.apply("ReduceSum", share, axis, keepdims=1)
    rho2 = graph.apply("ReduceSum", graph.apply("Div", mass, scored.widening), axis, keepdims=1)
    return graph.apply("Add", rho2, graph.constant(CENTRE_ERROR**2))


def _position(making: Making, mass: str, rho2: str | None) -> None:
    """Median and interval from the masses, drawn in about the median where tempered."""
    graph, fine = making.graph, making.design.cells > EXACT_SUMS
    before = graph.apply("CumSum", mass, graph.index(1), exclusive=1)
    part = graph.apply("Sub", graph.constant(np.array(QUANTILES).reshape(3, 1, 1)), before)
    part = graph.apply("Clip", graph.apply("Div", part, mass), graph.constant(0.0), graph.constant(1.0))
    along = graph.apply("Mul", part, graph.constant(making.tables.width_mm))
    # Products of the built-in kernels with a vector are three times slower than this.
    place = graph.apply("ReduceSum", graph.cast(along, np.float64) if fine else along, graph.ints(2), keepdims=0)
    if rho2 is not None:
        median = graph.apply("Gather", place, graph.index(0), axis=0)
        centre = _centre(making, mass, median) if making.design.precise and fine else median
        rho = graph.apply("Sqrt", graph.apply("Squeeze", rho2, graph.ints(1)))
        rho = graph.cast(rho, np.float64) if fine else rho
        place = graph.apply("Add", centre, graph.apply("Mul", graph.apply("Sub", place, median), rho))
    place = graph.cast(place, np.float32) if fine else place
    for index, name in enumerate(POSITION_OUTPUTS[:3]):
        graph.apply("Gather", place, graph.index(index), axis=0, output=name)


def _centre(making: Making, mass: str, median: str) -> str:
    """Return the mean where a posterior is as narrow as its tempering allows, the median elsewhere; (batch,) double.

    A median that is linear within its cell is off by up to a hundredth of the cell, which is more than a narrow
    posterior is wide before it is tempered. The mean of such a posterior has the error of a sum of a Gaussian, 1e-8.
    """
    graph, tables, axis = making.graph, making.tables, making.graph.ints(1)

    def mean_of(values: str) -> str:
        return graph.apply("ReduceSum", graph.apply("Mul", shares, values), axis, keepdims=1)

    shares = graph.cast(mass, np.float64)
    shares = graph.apply("Div", shares, graph.apply("ReduceSum", shares, axis, keepdims=1))
    middle = graph.constant(tables.middle_mm, np.float64)
    mean = mean_of(middle)
    off = graph.apply("Sub", middle, mean)
    cell = mean_of(graph.constant((NARROW * tables.width_mm * (tables.influence.any(axis=0))) ** 2, np.float64))
    narrow = graph.apply("Less", mean_of(graph.apply("Mul", off, off)), cell)
    narrow, mean = (graph.apply("Squeeze", value, axis) for value in (narrow, mean))
    return graph.apply("Where", narrow, mean, median)


def _known_force(making: Making, rest: str) -> None:
    """The force that the scene states, for every sample."""
    graph = making.graph
    zero = graph.apply("Mul", rest, graph.constant(0.0))
    for name in FORCE_OUTPUTS:
        graph.apply("Add", zero, graph.constant(making.prior.force_n[1]), output=name)


def _force(making: Making, mass: str, force: str, rho2: str | None) -> None:
    """Mean and interval of the force: its scatter over the cells, and its own width within one."""
    graph, axis = making.graph, making.graph.ints(1)
    (low, high), (middle, lower, upper) = making.prior.force_n, FORCE_OUTPUTS
    mean = graph.apply("ReduceSum", graph.apply("Mul", mass, force), axis, keepdims=1)
    off = graph.apply("Sub", force, mean)
    square = graph.apply("Mul", off, off)
    square = square if rho2 is None else graph.apply("Mul", square, rho2)
    square = graph.apply("Add", square, graph.constant(making.tables.force_variance))
    variance = graph.apply("ReduceSum", graph.apply("Mul", mass, square), axis, keepdims=0)
    bend = graph.apply("Mul", variance, graph.constant(BEND * 12 / (high - low) ** 2))
    squares = graph.apply("Add", bend, graph.constant(NORMAL**2 if rho2 is None else WIDER * NORMAL**2))
    half = graph.apply("Sqrt", graph.apply("Mul", variance, squares))
    mean = graph.apply("Squeeze", mean, axis, output=middle)
    graph.apply("Max", graph.apply("Sub", mean, half), graph.constant(low), output=lower)
    graph.apply("Min", graph.apply("Add", mean, half), graph.constant(high), output=upper)
