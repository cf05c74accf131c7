"""The posterior of a contact as an ONNX graph: no training, a few dozen operations, an error at the accuracy limit.

z is the sample with invalid channels at 0, and v the validity of the channels; s is the noise. The cells i = 1..N of
the position range have width w_i and influence g_i at their middles. The force F lies in [F1, F2].

    b_i = z . g_i      a_i = v . g_i^2      r = |z|^2                      products over the valid channels
    y_i = clip(b_i / a_i, F1 + d_i, F2 - d_i)     d_i = s / sqrt(a_i)      best force of a cell
    R_i = r - y_i (2 b_i - y_i a_i)                                        squared misfit
    S_i = -R_i / (2 s^2 t_i) + log(w_i h_i)       t_i = 1 + k_i r / s^2    log posterior mass of a cell
    p = softmax(S)     C_i = p_1 + .. + p_(i-1)
    x_q = x_0 + sum_i w_i clip((q - C_i) / p_i, 0, 1)                      quantiles, linear within a cell

It rests on three ideas (docs/decisions/005 has the measurements).

*Force.* The integral over the uniform range of the force is a difference of two normal distribution functions. Each of
them is replaced by half a Gaussian about a bound that is moved inwards by d. This needs a clip instead of two error
functions and two logarithms, and cannot underflow. h_i is the width of the force's posterior relative to its range.

*Tempering.* At small noise a posterior is narrower than a cell. Dividing its misfit by t_i widens it to about a cell.
Its centre stays right, because the sum of a Gaussian over equidistant points is right to 1e-8 if its deviation is at
least their distance. Then the quantiles are contracted about the median by rho, rho^2 = sum_i p_i / t_i, which restores
the width. Where cells resolve the posterior, as at the ends of the beam, t is 1.

*Rest.* Two more cells, without influence and with negligible weight, represent a beam that nothing touches. They give
the log odds of contact. If no contact explains the sample, they take the mass, and the interval is the whole range.
"""

from dataclasses import dataclass

import numpy as np
import onnx

from beamtouch_models.accuracy.prior import Prior
from beamtouch_models.estimators.onnx_graph import Graph, model
from beamtouch_models.estimators.posterior.cells import Design, design_for
from beamtouch_models.estimators.posterior.tables import FIRST, REST_WEIGHT, Tables, tables_of
from beamtouch_models.metadata import FORCE_OUTPUTS, INPUTS, POSITION_OUTPUTS

QUANTILES = (0.5, 0.025, 0.975)
NORMAL = 1.959964
"""97.5 % quantile of the normal distribution."""
BEND = -0.5
"""Change of the squared half width of the force's 95 % interval, in deviations, per ratio of its variance to that of a
uniform distribution on the range. It lies between the values for symmetric (beta) and one-sided distributions, and
comes from measured coverage."""
CENTRE_ERROR = 0.026
"""Error of a tempered posterior's centre for an open force, in units of its widened deviation; widens the interval."""
WIDER = 1.06
"""Factor that widens the square of the force's interval likewise."""
EXACT_SUMS = 512
"""Number of cells above which a sum of widths in float32 loses a digit of the interval."""
NARROW = 2.0
"""Largest deviation of a posterior, in cells, for which its mean is its centre."""
WIDEST = 1e4
"""Readings are clipped to this multiple of the largest deflection, so that nothing overflows."""
SMALLEST_LOG_MASS = -60.0
"""Keeps the place within an empty cell finite, and avoids subnormal numbers, which are slow."""


@dataclass(frozen=True)
class Making:
    """A posterior graph under construction, with its inputs."""

    prior: Prior
    design: Design
    tables: Tables
    graph: Graph

    @property
    def variance(self) -> float:
        """The square of the noise."""
        return self.prior.noise_mm**2

    def single(self, value: str) -> str:
        """Convert a result to float32 if it is double."""
        return self.graph.cast(value, np.float32) if self.design.precise else value


@dataclass(frozen=True)
class Scored:
    """Names of results, (batch, N) each."""

    score: str
    force: str | None = None
    """Best force of each cell; None if the force is known."""
    widening: str | None = None
    """t."""


def posterior_graph(prior: Prior, *, with_force: bool, design: Design | None = None) -> onnx.ModelProto:
    """Return the ONNX graph of a prior, without metadata; `design` replaces the default for the prior."""
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
    """Return the readings with invalid channels at 0, and the validity as numbers."""
    graph, (deflection, valid) = making.graph, INPUTS
    bound = WIDEST * making.prior.force_n[1] * float(np.abs(making.tables.influence).max())
    ends = [graph.constant(end, np.float32) for end in (0.0, -bound, bound)]
    reading = graph.apply("Clip", graph.apply("Where", valid, deflection, ends[0]), *ends[1:])
    return making.graph.cast(reading, np.float64) if making.design.precise else reading, graph.cast(valid, graph.real)


def _known(making: Making, reading: str, valid: str) -> Scored:
    """Score with a known force: the misfit r - 2 F b + F^2 a is linear in (z, v, r), so all scores are one product."""
    graph, tables, force = making.graph, making.tables, making.prior.force_n[1]
    weights = np.concatenate([force * tables.influence, -(force**2) / 2 * tables.squares]) / making.variance
    inputs = [reading, valid]
    # r shifts all scores of a reading equally, so it matters only to tempering and to the digits.
    if making.design.temper or making.design.precise:
        weights = np.concatenate([weights, np.full((1, weights.shape[1]), -0.5 / making.variance)])
        inputs.append(graph.apply("ReduceSumSquare", reading, axes=[1], keepdims=1))
    if making.design.temper:
        weights = weights / (1 + tables.temper)
    joined = graph.apply("Concat", *inputs, axis=1)
    score = graph.apply("Gemm", joined, graph.constant(weights), graph.constant(tables.log_weight))
    return Scored(making.single(score))


def _open(making: Making, reading: str, valid: str) -> Scored:
    """Score with an open force; squares are in units of 2 s^2 from the first product on."""
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
        # Slightly more than t, so that rho^2 including the error of the centre is at most 1.
        unit = 1 / (1 - CENTRE_ERROR**2)
        weights, least = unit / making.variance * tables.temper[None], np.full(len(tables.width_mm), unit)
        widening = graph.apply("Gemm", square, graph.constant(weights), graph.constant(least))
        score = graph.apply("Div", score, widening)
    return Scored(graph.apply("Add", score, graph.constant(tables.log_weight)), making.single(force), widening)


def _narrowing(making: Making, mass: str, scored: Scored) -> str:
    """Return rho^2, (batch, 1)."""
    graph, axis = making.graph, making.graph.ints(1)
    if scored.widening is None:
        share = graph.apply("Mul", mass, graph.constant(1 / (1 + making.tables.temper)))
        return graph.apply("ReduceSum", share, axis, keepdims=1)
    rho2 = graph.apply("ReduceSum", graph.apply("Div", mass, scored.widening), axis, keepdims=1)
    return graph.apply("Add", rho2, graph.constant(CENTRE_ERROR**2))


def _position(making: Making, mass: str, rho2: str | None) -> None:
    """Add median and interval from the masses, contracted about the median if tempered."""
    graph, fine = making.graph, making.design.cells > EXACT_SUMS
    before = graph.apply("CumSum", mass, graph.index(1), exclusive=1)
    part = graph.apply("Sub", graph.constant(np.array(QUANTILES).reshape(3, 1, 1)), before)
    part = graph.apply("Clip", graph.apply("Div", part, mass), graph.constant(0.0), graph.constant(1.0))
    along = graph.apply("Mul", part, graph.constant(making.tables.width_mm))
    # A matrix-vector product of the built-in kernels would be three times slower.
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
    """Add the force that the scene states, for every sample."""
    graph = making.graph
    zero = graph.apply("Mul", rest, graph.constant(0.0))
    for name in FORCE_OUTPUTS:
        graph.apply("Add", zero, graph.constant(making.prior.force_n[1]), output=name)


def _force(making: Making, mass: str, force: str, rho2: str | None) -> None:
    """Add mean and interval of the force, from its scatter over the cells and its width within a cell."""
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
