"""The force in the posterior graph: the mass of its prior that a cell explains, and the force that is stated."""

from dataclasses import dataclass

import numpy as np

from beamtouch_models.accuracy.forces import HIGHEST, Piece, forces_of
from beamtouch_models.arrays import Floats
from beamtouch_models.estimators.onnx_graph import Graph
from beamtouch_models.estimators.posterior.scoring import Scored
from beamtouch_models.metadata import FORCE_OUTPUTS

NORMAL = 1.959964
"""97.5 % quantile of the normal distribution."""
WIDER = 1.08
"""Factor that widens the interval where the posterior is tempered."""
BEYOND = 2.5
"""Distance of a cell's best force from the range, in root-2 deviations, from which it counts as beyond the range; at
about this distance the tail of the prior outweighs the range."""
FARTHEST = 60.0
"""Bound of an exponent, which avoids subnormal numbers; they are slow."""
NARROW = 1e4
"""Ratio of the densities of range and tail above which float32 cannot take their differences as one sum."""


def log_mass(graph: Graph, force_n: tuple[float, float], root: str, force: str, widening: str | None) -> str:
    """Return log(m), up to a constant, from the best force of each cell and the root of its precision.

    `widening` is that of the likelihood, if it is tempered.
    """
    ends, densities = _pieces(force_n)
    offset = graph.apply("Mul", graph.apply("Sub", graph.constant(ends[:, None]), force), root)
    known = force_n[0] == force_n[1]
    # Between the ends of a piece, the difference of erf is at most 2. For an open force it is 1 within the range.
    scale = np.sqrt(np.pi) / 2 if known else 0.5 / densities[1]
    total = _weighted(graph, graph.apply("Erf", offset), densities * scale)
    if known:
        total = graph.apply("Add", total, _known(graph, forces_of(force_n)[1], root, offset, widening))
    elif widening is not None:
        # Next to an end of the range a wide cell may lie beyond it, although the narrow posterior does not.
        return graph.apply("Sub", graph.apply("Div", graph.apply("Log", total), widening), graph.apply("Log", root))
    return graph.apply("Log", graph.apply("Div", total, root))


def _known(graph: Graph, core: Piece, root: str, offset: str, widening: str | None) -> str:
    """Return the mass of a known force times the root."""
    at = _row(graph, offset, 1)
    square = graph.apply("Mul", at, at)
    square = graph.apply("Div", square, widening) if widening else square
    square = graph.apply("Min", square, graph.constant(FARTHEST))
    near = graph.apply("Mul", graph.apply("Exp", graph.apply("Neg", square)), root)
    return graph.apply("Mul", near, graph.constant(core.share))


def _pieces(force_n: tuple[float, float]) -> tuple[Floats, Floats]:
    """Return the ends of the even pieces of the prior and their densities."""
    pieces = [piece for piece in forces_of(force_n) if piece.low_n < piece.high_n]
    ends = np.array([*(piece.low_n for piece in pieces), pieces[-1].high_n])
    return ends, np.array([piece.share for piece in pieces]) / np.diff(ends)


def _weighted(graph: Graph, ends: str, weights: Floats) -> str:
    """Return the weighted sum of the differences between neighbouring rows of (batch, rows, N)."""
    differences = np.eye(len(weights), len(weights) + 1, 1) - np.eye(len(weights), len(weights) + 1)
    if weights.max() > NARROW * weights.min():
        ends = graph.apply("MatMul", graph.constant(differences), ends)
        return graph.apply("MatMul", graph.constant(weights[None]), ends)
    return graph.apply("MatMul", graph.constant(weights[None] @ differences), ends)


@dataclass(frozen=True)
class Posteriors:
    """Names of the posteriors over the cells, (batch, 1, N)."""

    median: str
    ends: str
    """That of the interval."""
    contraction: str | None
    """Contraction of the interval, (batch, 1, 1), if the posterior is tempered."""


def state_force(graph: Graph, force_n: tuple[float, float], scored: Scored, root: str, posteriors: Posteriors) -> None:
    """Add the force, from the posterior of the median, and its interval, from that of the ends.

    A best force that is hardly beyond the range is moved to its end, which is then the likeliest force.
    """
    low, high = force_n
    known, force, contraction = low == high, scored.force, posteriors.contraction
    moved = graph.apply("Clip", force, graph.constant(low), graph.constant(high))
    beyond = graph.apply("Mul", graph.apply("Sub", force, moved), root)
    far = graph.apply("Greater", graph.apply("Abs", beyond), graph.constant(BEYOND))
    moved = graph.apply("Where", far, force, moved)
    axis = graph.ints(2)
    middle = graph.apply("ReduceSum", graph.apply("Mul", posteriors.median, moved), axis, keepdims=1)
    # Where a known force explains the sample, the cells hold it, and there is no deviation within them.
    stated = moved if known else force
    mean = graph.apply("ReduceSum", graph.apply("Mul", posteriors.ends, stated), axis, keepdims=1)
    off = graph.apply("Sub", stated, mean)
    square = graph.apply("Mul", off, off)
    square = graph.apply("Mul", square, contraction) if contraction else square
    if not known:
        square = graph.apply("Add", square, graph.apply("Div", graph.constant(0.5), scored.precision))
    variance = graph.apply("ReduceSum", graph.apply("Mul", posteriors.ends, square), axis, keepdims=1)
    both = np.array([-NORMAL, NORMAL]) * (WIDER if contraction else 1.0)
    interval = graph.apply("Mul", graph.apply("Sqrt", variance), graph.constant(both))
    interval = graph.apply("Add", mean, interval)
    interval = graph.apply("Clip", interval, graph.constant(0.0), graph.constant(HIGHEST * high))
    least, most = graph.split(interval, 2, 2)
    middle = graph.apply("Min", graph.apply("Max", middle, least), most)
    for name, value in zip(FORCE_OUTPUTS, (middle, least, most), strict=True):
        graph.apply("Squeeze", value, graph.ints(1, 2), output=name)


def _row(graph: Graph, value: str, row: int) -> str:
    return graph.apply("Slice", value, graph.ints(row), graph.ints(row + 1), graph.ints(1))
