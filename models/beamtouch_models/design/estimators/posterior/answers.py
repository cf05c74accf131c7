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
from 0 to 10 times the largest force (`accuracy.prior`). A force beyond the range gets its true place.

*Interval.* If the force is open, the interval comes from a second posterior, with a prior of the force that leans on
neither end of the range (`accuracy.prior`): it holds the truth also just outside the range, where the first prior
pulls the position towards a place that a force within the range explains. Both weight the same normal distribution
functions. Each quantile has a row of its own, and the interval reaches to the median, which keeps the first prior.

A quantile always leaves out a last stretch of the range, with the contacts there. So an end of the interval goes on to
that of the range if what it leaves out is short beside what the other end leaves between its quantiles: if the density
at the end of the range is not small. The other end then takes the inner one of its quantiles.

*Log odds.* log(sum_i s_i exp(-R_i)) + |y|^2, without the prior of the force: at rest their distribution depends
only on the directions of the influence, not on the size of the covariance.

*Misfit.* The smallest 2 R over the position: a parabola through the best three cells, which are neighbours. For a
single contact it is chi-square distributed, with two degrees of freedom less than there are channels. One or two
channels have a misfit only for a sample outside the cone of all contacts, such as a pull.

*Known force.* Each cell holds two possibilities: the known force F, whose likelihood is
exp(-a_i (F - f_i)^2) exp(-R_i), and a force from the tails of the prior, whose likelihood is m_i exp(-R_i).
"""

from dataclasses import dataclass

import numpy as np

from beamtouch_models.arrays import Floats
from beamtouch_models.design.accuracy.prior import MAX_FORCE_RATIO, Forces, Prior, cautious_forces, forces_of
from beamtouch_models.design.estimators.onnx_graph import Graph
from beamtouch_models.runtime.error_model import NORMAL_975
from beamtouch_models.runtime.metadata import FORCE_OUTPUTS, INPUTS, POSITION_OUTPUTS

MIN_PRECISION = np.pi / MAX_FORCE_RATIO**2
"""Added to a, over the square of the largest force: a cell that says nothing of the force has a best force, too."""
FLATTEST = 1e-26
"""Smallest curvature or square of a change, so that nothing is divided by 0."""
WIDEST = 1e4
"""Samples are clipped to this multiple of the largest deflection, so that nothing overflows."""
NARROW = 1e4
"""Ratio of the densities of range and tail above which float32 cannot take their differences as one sum."""
FARTHEST = -60.0
"""Bound of an exponent, which avoids subnormal numbers; they are slow."""
QUANTILES = (0.5, 0.025, 0.975, 0.035, 0.965)
"""The median, the ends of the interval, and the inner ends of one that reaches to the other end of the range."""
REACH = 2.0
"""An end goes on to that of the range if it leaves out at most this many times what lies between the quantiles of the
other end; from twice as much on, it does not."""
SHORTEST_MM = 1e-9
"""Keeps divisors off zero."""
MIN_MASS = 1e-26
"""Keeps the place within an empty cell finite, and avoids subnormal numbers, which are slow."""
MIN_EXPONENT = -50.0
"""Smallest logarithm of a likelihood over the largest, for the same reason; no quantile depends on smaller ones."""


@dataclass(frozen=True)
class Whitened:
    """Names of the sample, and of the sample and its whitening over the root of 2."""

    bounded: str
    """z, bounded, (batch, channels)"""
    sample: str
    """y, (batch, channels, 1)"""
    whitening: str
    """(batch, channels, channels), over the root of 2"""


@dataclass(frozen=True)
class Scored:
    """Names of results, (batch, 1, N) unless stated otherwise."""

    sample: str
    """y, (batch, channels, 1)"""
    own: str
    """y as each cell sees it, (batch, channels, 1) or (batch, channels, N): in the deviations of the cell."""
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


def whitened(graph: Graph, largest_mm: float) -> Whitened:
    """Whiten the sample; `largest_mm` is the largest deflection of the scene."""
    deflection, given = INPUTS
    bound = WIDEST * largest_mm
    whitening = graph.apply("Mul", given, graph.constant(0.5**0.5))
    bounded = graph.apply("Clip", deflection, graph.constant(-bound), graph.constant(bound))
    sample = graph.apply("MatMul", whitening, graph.apply("Unsqueeze", bounded, graph.ints(2)))
    return Whitened(bounded, sample, whitening)


def scored(graph: Graph, seen: Whitened, largest_n: float, influence: str, variance: str | None) -> Scored:
    """Return the misfit of the best force of each cell.

    `influence` is (channels, N) or (batch, channels, N) in mm/N, and `variance` that by the mounting.
    """
    sample, shape = seen.sample, graph.apply("MatMul", seen.whitening, influence)
    if variance is None:
        return Scored(sample, sample, shape, *_fitted(graph, sample, shape, largest_n), None)
    # The likeliest force says how much the mounting of the sensors adds to the variance of each channel.
    _, force, _ = _fitted(graph, sample, shape, largest_n)
    wider = widening(graph, force, variance)
    shape = graph.apply("Div", shape, wider)
    own = graph.apply("Div", sample, wider)
    fitted = _fitted(graph, own, shape, largest_n, own=True)
    return Scored(sample, own, shape, *fitted, graph.apply("ReduceProd", wider, axes=[1], keepdims=1))


def widening(graph: Graph, force: str, variance: str) -> str:
    """Return the factors by which the mounting of the sensors widens the errors, (batch, channels, N).

    Only the diagonal of its covariance is taken, as in `likelihood.log_density`.

    `force` is (batch, 1, N) or one number, and `variance` as that of `scored`.
    """
    given = INPUTS[1]
    moved = graph.apply("MatMul", graph.apply("Mul", given, given), variance)
    moved = graph.apply("Mul", moved, graph.apply("Mul", force, force))
    return graph.apply("Sqrt", graph.apply("Add", moved, graph.constant(1.0)))


def _fitted(graph: Graph, sample: str, shape: str, largest_n: float, *, own: bool = False) -> tuple[str, str, str]:
    """Return precision, best force and half the misfit of each cell; `own`: each cell has its own sample."""
    if own:
        along = graph.apply("ReduceSum", graph.apply("Mul", shape, sample), graph.ints(1), keepdims=1)
    else:
        along = graph.apply("MatMul", graph.apply("Transpose", sample, perm=[0, 2, 1]), shape)
    precision = graph.apply("ReduceSumSquare", shape, axes=[1], keepdims=1)
    precision = graph.apply("Add", precision, graph.constant(MIN_PRECISION / largest_n**2))
    force = graph.apply("Div", along, precision)
    force = graph.apply("Clip", force, graph.constant(0.0), graph.constant(MAX_FORCE_RATIO * largest_n))
    residual = graph.apply("Sub", sample, graph.apply("Mul", force, shape))
    return precision, force, graph.apply("ReduceSumSquare", residual, axes=[1], keepdims=1)


def lowest_of(graph: Graph, squares: str) -> tuple[str, str]:
    """Return the smallest of squares (batch, 1, N) at the middles of cells, and twice that over the position.

    The latter is that of a parabola through the best three cells, which are neighbours. Both are (batch, 1, 1).
    """
    three, _ = graph.top(squares, 3, 2, largest=False)
    # Least value, twice that, slope and curvature, scaled so that the parabola is lowest at 2 R - slope^2 / curvature.
    parabola: Floats = np.array([[1.0, 2.0, 0.0, -2.0], [0.0, 0.0, -0.5, 1.0], [0.0, 0.0, 0.5, 1.0]])
    least, value, slope, curvature = graph.split(graph.apply("MatMul", three, graph.constant(parabola)), 4, 2)
    # Of the smallest of three, the curvature is at least twice the slope, but for rounding.
    curvature = graph.apply("Max", curvature, slope, graph.constant(FLATTEST))
    drop = graph.apply("Mul", slope, graph.apply("Div", slope, curvature))
    return least, graph.apply("Sub", value, drop)


def mass_of(graph: Graph, force_n: tuple[float, float], root: str, force: str) -> str:
    """Return m of an open force, up to a factor, from the best force of each cell and the root of its precision.

    It is yet to be divided by that root, which takes less time for the one row of likelihoods. It has a row for the
    prior of the median and one for each end of the interval.
    """
    cautious = cautious_forces(force_n)
    ends, offset = _offset(graph, cautious, root, force)
    error = graph.apply("Erf", offset)
    # Between the ends of a piece, the difference of erf is at most 2; the masses are 1 within the range.
    rows = np.stack([_densities(forces_of(force_n), ends), *[_densities(cautious, ends)] * 2])
    return _weighted(graph, error, 0.5 * rows / rows[:, 2:3])


def _offset(graph: Graph, forces: Forces, root: str, force: str) -> tuple[Floats, str]:
    """Return the ends of all pieces, and their distances from the best force of each cell, in root-2 deviations."""
    ends = np.unique([end for piece in forces for end in (piece.low_n, piece.high_n)])
    return ends, graph.apply("Mul", graph.apply("Sub", graph.constant(ends[:, None]), force), root)


def _densities(forces: Forces, ends: Floats) -> Floats:
    """Return the density of a prior between neighbouring ends, which hold all ends of its pieces."""
    middle = (ends[1:] + ends[:-1]) / 2
    pieces = [piece for piece in forces if piece.low_n < piece.high_n]
    inside = [(piece.low_n < middle) & (middle < piece.high_n) for piece in pieces]
    density: Floats = np.select(inside, [piece.share / (piece.high_n - piece.low_n) for piece in pieces])
    return density


def _weighted(graph: Graph, ends: str, weights: Floats) -> str:
    """Return weighted sums (batch, sums, N) of differences between neighbours of (batch, rows, N).

    `weights` are (sums, rows - 1).
    """
    pieces = weights.shape[1]
    differences = np.eye(pieces, pieces + 1, 1) - np.eye(pieces, pieces + 1)
    if weights.max() > NARROW * weights.min():
        ends = graph.apply("MatMul", graph.constant(differences), ends)
        return graph.apply("MatMul", graph.constant(weights), ends)
    return graph.apply("MatMul", graph.constant(weights @ differences), ends)


def state_force(graph: Graph, force_n: tuple[float, float], scored: Scored, posterior: str, *, fine: bool) -> None:
    """Add an open force, from the posterior of the median, and its interval, from those of the ends.

    `fine` says that the force may be known to the last digits of float32.
    """
    axis, force = graph.ints(2), scored.force
    # Of three rows, this takes less time than a product and its sum.
    mean = graph.apply("MatMul", posterior, graph.apply("Transpose", force, perm=[0, 2, 1]))
    off = graph.apply("Sub", force, mean)
    if fine:
        # Rounding in a sum of large numbers, and a posterior that adds up to nearly 1, move the mean.
        rest = graph.apply("ReduceSum", graph.apply("Mul", posterior, off), axis, keepdims=1)
        mean = graph.apply("Add", mean, rest)
    square = graph.apply("Mul", off, off)
    square = graph.apply("Add", square, graph.apply("Div", graph.constant(0.5), scored.precision))
    variance = graph.apply("ReduceSum", graph.apply("Mul", posterior, square), axis, keepdims=1)
    deviations = np.array([0.0, -NORMAL_975, NORMAL_975])[:, None]
    value = graph.apply("Add", mean, graph.apply("Mul", graph.apply("Sqrt", variance), graph.constant(deviations)))
    value = graph.apply("Clip", value, graph.constant(0.0), graph.constant(MAX_FORCE_RATIO * force_n[1]))
    first = graph.apply("Gather", value, graph.index(0), axis=1)
    graph.apply("Squeeze", first, graph.ints(1), output=FORCE_OUTPUTS[0])
    graph.apply("ReduceMin", value, axes=[1, 2], keepdims=0, output=FORCE_OUTPUTS[1])
    graph.apply("ReduceMax", value, axes=[1, 2], keepdims=0, output=FORCE_OUTPUTS[2])


def known_force(graph: Graph, known_n: float, found: Scored, root: str) -> tuple[str, str]:
    """Return the likelihoods of the known force and of the tails in each cell, (batch, 1, N), up to one factor.

    They are yet to be multiplied by exp(-R).
    """
    forces = forces_of((known_n, known_n))
    ends, offset = _offset(graph, forces, root, found.force)
    density = _densities(forces, ends)[None] / forces[1].share
    tails = _weighted(graph, graph.apply("Erf", offset), density * np.sqrt(np.pi) / 2)
    square = graph.apply("Mul", offset, offset)
    distance = graph.apply("MatMul", graph.constant(-(ends == known_n)[None].astype(np.float64)), square)
    tails = graph.apply("Div", tails, root)
    return graph.apply("Exp", graph.apply("Max", distance, graph.constant(FARTHEST))), tails


def state_known_force(graph: Graph, known_n: float, scored: Scored, posterior: str, likely: tuple[str, str]) -> None:
    """Add the known force, or the one that the sample shows instead, and its interval; `likely` as `known_force`."""
    axis, known = graph.ints(2), graph.constant(known_n)

    def mean_of(values: str, weights: str) -> str:
        return graph.apply("ReduceSum", graph.apply("Mul", weights, values), axis, keepdims=1)

    tail_share = graph.apply("Div", likely[1], graph.apply("Add", *likely))
    tails = graph.apply("Mul", posterior, tail_share)
    beyond = graph.apply("Sub", scored.force, known)
    # From the known force on, where there is most of the mass.
    mean = mean_of(beyond, tails)
    off = graph.apply("Sub", beyond, mean)
    square = graph.apply("Mul", off, off)
    square = graph.apply("Add", square, graph.apply("Div", graph.constant(0.5), scored.precision))
    part = graph.apply("ReduceSum", tails, axis, keepdims=1)
    at_known = graph.apply("Mul", graph.apply("Mul", mean, mean), graph.apply("Sub", graph.constant(1.0), part))
    variance = graph.apply("Add", mean_of(square, tails), graph.apply("Max", at_known, graph.constant(0.0)))
    deviations = np.array([0.0, -NORMAL_975, NORMAL_975])
    value = graph.apply("Mul", graph.apply("Sqrt", variance), graph.constant(deviations))
    value = graph.apply("Add", graph.apply("Add", mean, known), value)
    value = graph.apply("Clip", value, graph.constant(0.0), graph.constant(MAX_FORCE_RATIO * known_n))
    for name, result in zip(FORCE_OUTPUTS, graph.split(value, 3, 2), strict=True):
        graph.apply("Squeeze", result, graph.ints(1, 2), output=name)


@dataclass(frozen=True)
class Grid:
    """The cells of the position range, from `low_mm` on; names of (1, 1, N) or (batch, 1, N)."""

    width: str
    """w, in mm"""
    share: str
    """s"""
    low_mm: float
    fine: bool = False
    """Whether cells may be so narrow that plain sums in float32 would lose a digit of the interval."""


def state_answers(graph: Graph, prior: Prior, found: Scored, least: str, grid: Grid, *, with_force: bool) -> list[str]:
    """Add every answer except for the misfit, and return the names of all outputs; `least` is the smallest R."""
    root, force_n = graph.apply("Sqrt", found.precision), prior.force_n
    # Sums of exponentials and their logarithm take less time than the operations that do both.
    exponent = graph.apply("Sub", least, found.misfit)
    if not prior.force_is_known:
        exponent = graph.apply("Max", exponent, graph.constant(MIN_EXPONENT))
    likely = graph.apply("Mul", graph.apply("Exp", exponent), grid.share)
    axes = graph.ints(1, 2)
    touched = graph.apply("ReduceLogSum", likely, axes=[1, 2], keepdims=1)
    rest = graph.apply("ReduceSumSquare", found.sample, axes=[1, 2], keepdims=1)
    odds = graph.apply("Add", touched, graph.apply("Sub", rest, least))
    graph.apply("Squeeze", odds, axes, output="contact_log_odds")
    known = known_force(graph, force_n[1], found, root) if prior.force_is_known else None
    if known:
        likely = graph.apply("Mul", graph.apply("Add", *known), likely)
    if found.widened is not None:
        likely = graph.apply("Div", likely, found.widened)
    if not known:
        mass = mass_of(graph, force_n, root, found.force)
        likely = graph.apply("Mul", graph.apply("Div", likely, root), mass)
    posterior = graph.apply("LpNormalization", likely, axis=2, p=1)
    posterior = graph.apply("Max", posterior, graph.constant(MIN_MASS))
    low_mm, high_mm = prior.extent.range_mm
    _state_position(graph, grid, posterior, high_mm - low_mm, every_row=known is None)
    if not with_force:
        return list(POSITION_OUTPUTS)
    if known:
        state_known_force(graph, force_n[1], found, posterior, known)
    else:
        state_force(graph, force_n, found, posterior, fine=grid.fine)
    return [*POSITION_OUTPUTS, *FORCE_OUTPUTS]


def _state_position(graph: Graph, grid: Grid, posterior: str, length_mm: float, *, every_row: bool) -> None:
    """Add median and interval from the posteriors over the cells; `length_mm` is that of the range.

    `every_row`: there is one posterior for the median and one for each end; otherwise one for all.
    """
    before = graph.apply("CumSum", posterior, graph.index(2), exclusive=1)
    if every_row:
        rows = graph.ints(0, 1, 2, 1, 2)
        before, posterior = (graph.apply("Gather", values, rows, axis=1) for values in (before, posterior))
    part = graph.apply("Sub", graph.constant(np.array(QUANTILES).reshape(1, -1, 1)), before)
    part = graph.apply("Clip", graph.apply("Div", part, posterior), graph.constant(0.0), graph.constant(1.0))
    # A matrix-vector product of the built-in kernels would be three times slower.
    along = graph.apply("Mul", part, grid.width)
    along = graph.cast(along, np.float64) if grid.fine else along
    place = graph.apply("ReduceSum", along, graph.ints(2), keepdims=0)
    place = graph.cast(place, np.float32) if grid.fine else place
    stated = _reaching(graph, place, grid.low_mm, length_mm)
    graph.apply("Gather", stated, graph.index(0), axis=1, output=POSITION_OUTPUTS[0])
    graph.apply("ReduceMin", stated, axes=[1], keepdims=0, output=POSITION_OUTPUTS[1])
    graph.apply("ReduceMax", stated, axes=[1], keepdims=0, output=POSITION_OUTPUTS[2])


def _reaching(graph: Graph, place: str, low_mm: float, length_mm: float) -> str:
    """Return median and interval (batch, 3) from the QUANTILES (batch, 5), which count from the low end of the range.

    l and h are what the ends of the interval leave out, a and b what lies between the quantiles of the other end:

        l = x_025    h = length - x_975    a = x_975 - x_965    b = x_035 - x_025
        t = clip(l / (REACH a) - 1, 0, 1)    u = clip(h / (REACH b) - 1, 0, 1)
        low = t (l + (1 - u) b)              high = length - u (h + (1 - t) a)
    """
    left_out = np.array([[0, 1, 0, 0, 0], [0, 0, -1, 0, 0]])
    between = REACH * np.array([[0, 0, 1, 0, -1], [0, -1, 0, 1, 0]])
    bias = np.array([0.0, length_mm])
    rows = graph.constant(np.concatenate([left_out, left_out - between, between]).T)
    parts = graph.apply("Gemm", place, rows, graph.constant(np.concatenate([bias, bias, [0.0, 0.0]])))
    left, beyond, across = graph.split(parts, 3, 1)
    across = graph.apply("Max", across, graph.constant(SHORTEST_MM))
    stays = graph.apply("Div", beyond, across)
    stays = graph.apply("Clip", stays, graph.constant(0.0), graph.constant(1.0))
    # What each end gives up for the other one, which it names first.
    given = graph.apply("Sub", across, graph.apply("Mul", stays, across))
    given = graph.apply("MatMul", given, graph.constant([[0.0, 1 / REACH], [1 / REACH, 0.0]]))
    left = graph.apply("Mul", stays, graph.apply("Add", left, given))
    every = graph.apply("Concat", place, left, axis=1)
    stated = np.zeros((7, 3))
    stated[0, 0], stated[5, 1], stated[6, 2] = 1.0, 1.0, -1.0
    return graph.apply("Gemm", every, graph.constant(stated), graph.constant([low_mm, low_mm, low_mm + length_mm]))
