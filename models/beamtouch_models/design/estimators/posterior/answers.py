"""The posterior of a contact as an ONNX graph: no training, a few dozen operations, an error at the accuracy limit.

z is the sample and W its whitening, in which a missing channel is a zero row and column. The cells i = 1..N of the
position range have width w_i, share s_i of the range, and influence g_i at their middles.

    y = W z / sqrt(2)      H_i = W g_i / sqrt(2)      a_i = |H_i|^2           products over the channels
    f_i = clip(H_i . y / a_i, 0, F)                                           best force of a cell
    R_i = |y - f_i H_i|^2                                                     half misfit, no difference of squares
    m_i = mean of exp(-a_i (f - f_i)^2) over the prior of the force           a sum of normal distribution functions
    p_i ~ s_i m_i exp(-R_i)                    C_i = p_1 + .. + p_(i-1)       posterior over the cells
    x_q = x_0 + sum_i w_i clip((q - C_i) / p_i, 0, 1)                         quantiles, linear within a cell

*Uncertain influence.* Of a sensor whose place or table is not exact, y and H are divided by the deviation that this
adds at the best force. Then each source of errors that sensors share takes its direction out of both: with c, by how
much it moves y, they become (I + c c')^-1/2 y and (I + c c')^-1/2 H, in the same way the sources that follow.

*Force.* Its prior is even over the range of the scene, which may be as narrow as one force, with a hundredth of the
mass in tails from 0 to 10 times the largest force (`accuracy.prior`). A force beyond the range gets its true place.

*Interval.* It comes from a second posterior, with a prior of the force that leans on neither end of the range
(`accuracy.prior`): it holds the truth also at the ends of the range, and just outside if the force is open, where the
first prior pulls the position towards a place that a force within the range explains. Both weight the same normal
distribution functions. Each quantile has a row of its own, and the interval reaches to the median, which keeps the
first prior.

A quantile always leaves out a last stretch of the range, with the contacts there. So an end of the interval goes on to
that of the range if what it leaves out is short beside what the other end leaves between its quantiles: if the density
at the end of the range is not small. The other end then takes the inner one of its quantiles.

*Log odds.* log(sum_i s_i exp(-R_i)) + |y|^2, without the prior of the force: at rest their distribution depends
only on the directions of the influence, not on the size of the covariance.

*Misfit.* The smallest 2 R over the position: a parabola through the best three cells, which are neighbours. A force
beyond a range that is not open adds to it (`runtime.force_range`). For a single contact the misfit is chi-square
distributed, with two degrees of freedom less than there are channels, or one if the force is exact. One or two channels
have a misfit of an open force only for a sample outside the cone of all contacts, such as a pull.
"""

from dataclasses import dataclass

import numpy as np

from beamtouch_models.arrays import Floats
from beamtouch_models.design.accuracy.prior import MAX_FORCE_RATIO, Forces, Prior, forces_of, interval_forces
from beamtouch_models.design.estimators.onnx_graph import Graph
from beamtouch_models.design.estimators.posterior.fitted_cells import Scored
from beamtouch_models.runtime.error_model import NORMAL_975
from beamtouch_models.runtime.force_range import ForceRange
from beamtouch_models.runtime.metadata import FORCE_OUTPUTS, POSITION_OUTPUTS

FLATTEST = 1e-26
"""Smallest curvature or square of a change, so that nothing is divided by 0."""
NARROW = 1e4
"""Ratio of the densities of range and tail above which float32 cannot take their differences as one sum."""
ROUNDING = 2e-7
"""Error of a difference of erf in float32."""
NARROWEST = 0.1
"""Half a range, in deviations of the loudest contact, below which differences of erf say too little of it."""
NODES = 4
"""Nodes of Gauss's rule over such a range: enough up to thirty times as many deviations, as in a long mean."""
FARTHEST = -60.0
"""Bound of an exponent, which avoids subnormal numbers; they are slow."""
QUANTILES = (0.5, 0.025, 0.975, 0.035, 0.965)
"""The median, the ends of the interval, and the inner ends of one that reaches to the other end of the range."""
REACH = 3.0
"""An end goes on to that of the range if it leaves out at most this many times what lies between the quantiles of the
other end; from twice as much on, it does not. Of an even density it leaves out 2.5 times as much, as also within a
single cell, in which a contact at the end of the range may have all of its posterior."""
SHORTEST_MM = 1e-9
"""Keeps divisors off zero."""
MIN_MASS = 1e-26
"""Keeps the place within an empty cell finite, and avoids subnormal numbers, which are slow."""
MIN_EXPONENT = -50.0
"""Smallest logarithm of a likelihood over the largest, for the same reason; no quantile depends on smaller ones."""


def likely_misfit(graph: Graph, stated: ForceRange, found: Scored) -> str:
    """Return half the misfit of each cell, with what its force adds that is beyond the stated range.

    Of the penalty P and the precision a, the best force between its own and the nearest end leaves a P / (a + P) times
    the square of their distance.
    """
    if stated.is_open:
        return found.misfit
    nearest = graph.apply("Clip", found.force, graph.constant(stated.low_n), graph.constant(stated.high_n))
    beyond = graph.apply("Sub", found.force, nearest)
    # In units of the largest penalty, float32 holds the harmonic sum of an exact force too.
    inverse = graph.apply("Add", graph.apply("Reciprocal", found.precision), graph.constant(2 / stated.penalty_per_n2))
    added = graph.apply("Div", graph.apply("Mul", beyond, beyond), inverse)
    return graph.apply("Add", found.misfit, added)


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


@dataclass(frozen=True)
class Masses:
    """Names of what the forces of each cell weigh, (batch, 3, N): for the median, and for each end of the interval.

    Of an exact force there is one row for all.
    """

    every: str
    """m times the root of the precision, up to a factor."""
    beyond: str | None
    """The part of it from beyond the range; None for an open force."""


def masses_of(graph: Graph, prior: Prior, root: str, force: str) -> Masses:
    """Return m from the best force of each cell and the root of its precision.

    It is yet to be divided by that root, which takes less time for the one row of likelihoods. It has a row for the
    prior of the median and one for each end of the interval.
    """
    median, interval = forces_of(prior.force_n), interval_forces(prior.force_n)
    ends = np.unique([end for piece in (*median, *interval) for end in (piece.low_n, piece.high_n)])
    loudest = prior.channels**0.5 * prior.largest_mm / float(prior.rest_mm.min())
    if prior.force_range.half_n * loudest < NARROWEST * prior.force_range.middle_n:
        return _masses_of_narrow(graph, prior, root, force)
    # Between the ends of a piece, the difference of erf is at most 2; the masses are 1 within the range.
    rows = np.stack([_densities(median, ends), *[_densities(interval, ends)] * 2])
    rows *= 0.5 / rows[:, np.searchsorted(ends, prior.force_n[0])][:, None]
    error = graph.apply("Erf", _offset(graph, ends, root, force))
    if prior.force_range.is_open:
        return Masses(_weighted(graph, error, rows), None)
    cores = [forces[len(forces) // 2] for forces in (median, interval, interval)]
    is_beyond = [(ends[1:] <= core.low_n) | (core.high_n <= ends[:-1]) for core in cores]
    every = _weighted(graph, error, np.concatenate([rows, rows * is_beyond]))
    return Masses(*graph.split(every, 2, 1))


def _masses_of_narrow(graph: Graph, prior: Prior, root: str, force: str) -> Masses:
    """Return m of a range over which float32 would lose the differences of erf.

    Gauss's rule integrates over it. Of an exact force, the integrand itself counts, and one row is that of all.
    """
    is_exact, (low_n, high_n) = prior.force_n[0] == prior.force_n[1], prior.force_n
    priors = [forces_of(prior.force_n), *[interval_forces(prior.force_n)] * (0 if is_exact else 2)]
    core = priors[-1][len(priors[-1]) // 2]
    ends = np.unique([end for piece in priors[-1] for end in (piece.low_n, piece.high_n)])
    rows = np.stack([_densities(forces, ends) for forces in priors])
    rows[:, (core.low_n <= ends[:-1]) & (ends[1:] <= core.high_n)] = 0.0
    beyond = _weighted(graph, graph.apply("Erf", _offset(graph, ends, root, force)), rows)
    place, weight = np.polynomial.legendre.leggauss(1 if is_exact else NODES)
    nodes_n, shares = prior.force_range.middle_n + prior.force_range.half_n * place, weight[None] / 2
    if not is_exact:
        # One node for what either end of the range has in addition, for the interval.
        added = (low_n - core.low_n) / (core.high_n - core.low_n)
        nodes_n = np.array([(core.low_n + low_n) / 2, *nodes_n, (high_n + core.high_n) / 2])
        wide = [added, *(1 - 2 * added) * weight / 2, added]
        shares = np.array([[0.0, *weight / 2, 0.0], wide, wide])
    shares = 2 / np.sqrt(np.pi) * np.array([[forces[len(forces) // 2].share] for forces in priors]) * shares
    offset = _offset(graph, nodes_n, root, force)
    exponent = graph.apply("Max", graph.apply("Neg", graph.apply("Mul", offset, offset)), graph.constant(FARTHEST))
    within = graph.apply("Exp", exponent)
    if shares.size == 1:
        within = graph.apply("Mul", within, graph.constant(shares.item()))
    else:
        within = graph.apply("MatMul", graph.constant(shares), within)
    return Masses(graph.apply("Add", beyond, graph.apply("Mul", within, root)), beyond)


def _offset(graph: Graph, forces_n: Floats, root: str, force: str) -> str:
    """Return the distances of forces (rows,) from the best force of each cell, in root-2 deviations, (batch, rows, N).

    `root` is the root of the precision.
    """
    return graph.apply("Mul", graph.apply("Sub", graph.constant(forces_n[:, None]), force), root)


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
    if weights.max() > NARROW * weights[weights > 0].min():
        ends = graph.apply("MatMul", graph.constant(differences), ends)
        # Far from a narrow range, rounding must not outweigh the tails.
        ends = graph.apply("Max", graph.apply("Sub", ends, graph.constant(ROUNDING)), graph.constant(0.0))
        return graph.apply("MatMul", graph.constant(weights), ends)
    return graph.apply("MatMul", graph.constant(weights @ differences), ends)


def state_force(graph: Graph, stated: ForceRange, found: Scored, posterior: str, masses: Masses, *, fine: bool) -> None:
    """Add the force, from the posterior of the median, and its interval, from those of the ends.

    `fine` says that the force may be known to the last digits of float32.
    """
    axis = graph.ints(2)
    if masses.beyond is None:
        force, variance = found.force, graph.apply("Div", graph.constant(0.5), found.precision)
        # Of three rows, this takes less time than a product and its sum.
        mean = graph.apply("MatMul", posterior, graph.apply("Transpose", force, perm=[0, 2, 1]))
    else:
        force, variance = _told_force(graph, stated, found, masses.every, masses.beyond)
        mean = graph.apply("ReduceSum", graph.apply("Mul", posterior, force), axis)
    off = graph.apply("Sub", force, mean)
    if fine:
        # Rounding in a sum of large numbers, and a posterior that adds up to nearly 1, move the mean.
        rest = graph.apply("ReduceSum", graph.apply("Mul", posterior, off), axis)
        mean = graph.apply("Add", mean, rest)
    square = graph.apply("Mul", off, off)
    square = graph.apply("Add", square, variance)
    variance = graph.apply("ReduceSum", graph.apply("Mul", posterior, square), axis)
    deviations = np.array([0.0, -NORMAL_975, NORMAL_975])[:, None]
    value = graph.apply("Add", mean, graph.apply("Mul", graph.apply("Sqrt", variance), graph.constant(deviations)))
    if masses.beyond is not None:
        value = graph.apply("Add", value, graph.constant(stated.middle_n))
    value = graph.apply("Clip", value, graph.constant(0.0), graph.constant(MAX_FORCE_RATIO * stated.high_n))
    first = graph.apply("Gather", value, graph.index(0), axis=1)
    graph.apply("Squeeze", first, graph.ints(1), output=FORCE_OUTPUTS[0])
    graph.apply("ReduceMin", value, axes=[1, 2], keepdims=0, output=FORCE_OUTPUTS[1])
    graph.apply("ReduceMax", value, axes=[1, 2], keepdims=0, output=FORCE_OUTPUTS[2])


def _told_force(graph: Graph, stated: ForceRange, found: Scored, every: str, beyond: str) -> tuple[str, str]:
    """Return mean and variance of the force of each cell, (batch, 3, N), from the middle of a range that is not open.

    A force within the range is told by the sample and by the range, as a reading of its middle; one beyond it by the
    sample alone. `every` and `beyond` are `Masses`.
    """
    read = graph.constant(0.5 * stated.precision_per_n2)
    outside, both = graph.apply("Div", beyond, every), graph.apply("Add", found.precision, read)
    inside = graph.apply("Sub", graph.constant(1.0), outside)
    pulled = graph.apply("Div", read, both)
    apart = graph.apply("Sub", found.force, graph.constant(stated.middle_n))
    kept = graph.apply("Add", graph.apply("Div", found.precision, both), graph.apply("Mul", pulled, outside))
    variance = graph.apply("Add", graph.apply("Div", outside, found.precision), graph.apply("Div", inside, both))
    between = graph.apply("Mul", apart, pulled)
    between = graph.apply("Mul", graph.apply("Mul", between, between), graph.apply("Mul", inside, outside))
    variance = graph.apply("Add", graph.apply("Mul", variance, graph.constant(0.5)), between)
    return graph.apply("Mul", apart, kept), variance


@dataclass(frozen=True)
class Grid:
    """The cells of the position range, from `low_mm` on; names of (1, 1, N) or (batch, 1, N)."""

    width: str
    """w, in mm"""
    share: str
    """s"""
    low_mm: float
    fine: bool = False
    """True if cells may be so narrow that plain sums in float32 would lose a digit of the interval."""


def state_answers(graph: Graph, prior: Prior, found: Scored, least: str, grid: Grid, *, with_force: bool) -> list[str]:
    """Add every answer except for the misfit, and return the names of all outputs; `least` is the smallest R."""
    root = graph.apply("Sqrt", found.precision)
    # Sums of exponentials and their logarithm take less time than the operations that do both.
    exponent = graph.apply("Sub", least, found.misfit)
    exponent = graph.apply("Max", exponent, graph.constant(MIN_EXPONENT))
    likely = graph.apply("Mul", graph.apply("Exp", exponent), grid.share)
    axes = graph.ints(1, 2)
    touched = graph.apply("ReduceLogSum", likely, axes=[1, 2])
    rest = graph.apply("ReduceSumSquare", found.sample, axes=[1, 2])
    odds = graph.apply("Add", touched, graph.apply("Sub", rest, least))
    graph.apply("Squeeze", odds, axes, output="contact_log_odds")
    if found.widened is not None:
        likely = graph.apply("Div", likely, found.widened)
    masses = masses_of(graph, prior, root, found.force)
    likely = graph.apply("Mul", graph.apply("Div", likely, root), masses.every)
    posterior = graph.apply("LpNormalization", likely, axis=2, p=1)
    posterior = graph.apply("Max", posterior, graph.constant(MIN_MASS))
    low_mm, high_mm = prior.extent.range_mm
    is_exact = prior.force_n[0] == prior.force_n[1]
    _state_position(graph, grid, posterior, high_mm - low_mm, every_row=not is_exact)
    if not with_force:
        return list(POSITION_OUTPUTS)
    state_force(graph, prior.force_range, found, posterior, masses, fine=grid.fine)
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
    stated = reaching(graph, place, (grid.low_mm, grid.low_mm + length_mm))
    graph.apply("Gather", stated, graph.index(0), axis=1, output=POSITION_OUTPUTS[0])
    graph.apply("ReduceMin", stated, axes=[1], keepdims=0, output=POSITION_OUTPUTS[1])
    graph.apply("ReduceMax", stated, axes=[1], keepdims=0, output=POSITION_OUTPUTS[2])


def reaching(graph: Graph, place: str, *ranges_mm: tuple[float, float]) -> str:
    """Return median and interval (batch, 3) from the QUANTILES (batch, 5), which count from the low end of the range.

    Of several ranges, one an axis, they are (batch, axes, 3) and (batch, axes, 5).

    l and h are what the ends of the interval leave out, a and b what lies between the quantiles of the other end:

        l = x_025    h = length - x_975    a = x_975 - x_965    b = x_035 - x_025
        t = clip(l / (REACH a) - 1, 0, 1)    u = clip(h / (REACH b) - 1, 0, 1)
        low = t (l + (1 - u) b)              high = length - u (h + (1 - t) a)
    """
    axis = len(ranges_mm)
    left_out = np.array([[0, 1, 0, 0, 0], [0, 0, -1, 0, 0]])
    between = REACH * np.array([[0, 0, 1, 0, -1], [0, -1, 0, 1, 0]])
    bias = [[0.0, high_mm - low_mm] * 2 + [0.0, 0.0] for low_mm, high_mm in ranges_mm]
    parts = _mapped(graph, place, np.concatenate([left_out, left_out - between, between]).T, bias)
    left, beyond, across = graph.split(parts, 3, axis)
    across = graph.apply("Max", across, graph.constant(SHORTEST_MM))
    stays = graph.apply("Div", beyond, across)
    stays = graph.apply("Clip", stays, graph.constant(0.0), graph.constant(1.0))
    # What each end gives up for the other one, which it names first.
    given = graph.apply("Sub", across, graph.apply("Mul", stays, across))
    given = graph.apply("MatMul", given, graph.constant([[0.0, 1 / REACH], [1 / REACH, 0.0]]))
    left = graph.apply("Mul", stays, graph.apply("Add", left, given))
    every = graph.apply("Concat", place, left, axis=axis)
    stated = np.zeros((7, 3))
    stated[0, 0], stated[5, 1], stated[6, 2] = 1.0, 1.0, -1.0
    return _mapped(graph, every, stated, [[low_mm, *_outwards(low_mm, high_mm)] for low_mm, high_mm in ranges_mm])


def _mapped(graph: Graph, values: str, rows: Floats, bias: list[list[float]]) -> str:
    """Return values (batch, n) times rows (n, m) plus a bias; values are (batch, rows, n) if the bias has more rows."""
    if len(bias) == 1:
        return graph.apply("Gemm", values, graph.constant(rows), graph.constant(bias[0]))
    return graph.apply("Add", graph.apply("MatMul", values, graph.constant(rows)), graph.constant(bias))


def _outwards(low_mm: float, high_mm: float) -> tuple[float, float]:
    """Return the ends of the range in float32, which does not round them inwards, past a contact at the very end."""
    low, high = np.float32(low_mm), np.float32(high_mm)
    # Compared in float64: beside a float32, numpy would round the range first.
    return (
        float(low if float(low) <= low_mm else np.nextafter(low, np.float32(-np.inf))),
        float(high if float(high) >= high_mm else np.nextafter(high, np.float32(np.inf))),
    )
