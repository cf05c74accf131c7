"""The force in the posterior graph: the mass of its prior that a cell explains, and the force that is stated.

If the force is known, each cell holds two possibilities: the known force F, whose likelihood is
exp(-a_i (F - f_i)^2) exp(-R_i), and a force from the tails of the prior, whose likelihood is m_i exp(-R_i); see `graph`
for the symbols.
"""

from dataclasses import dataclass

import numpy as np

from beamtouch_models.accuracy.forces import MAX_FORCE_RATIO, Forces, cautious_forces, forces_of
from beamtouch_models.arrays import Floats
from beamtouch_models.error_model import NORMAL_975
from beamtouch_models.estimators.onnx_graph import Graph
from beamtouch_models.estimators.posterior.scoring import Scored
from beamtouch_models.metadata import FORCE_OUTPUTS

NARROW = 1e4
"""Ratio of the densities of range and tail above which float32 cannot take their differences as one sum."""


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
    found: Floats = np.select(inside, [piece.share / (piece.high_n - piece.low_n) for piece in pieces])
    return found


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
    both = np.array([0.0, -NORMAL_975, NORMAL_975])[:, None]
    value = graph.apply("Add", mean, graph.apply("Mul", graph.apply("Sqrt", variance), graph.constant(both)))
    value = graph.apply("Clip", value, graph.constant(0.0), graph.constant(MAX_FORCE_RATIO * force_n[1]))
    first = graph.apply("Gather", value, graph.index(0), axis=1)
    graph.apply("Squeeze", first, graph.ints(1), output=FORCE_OUTPUTS[0])
    graph.apply("ReduceMin", value, axes=[1, 2], keepdims=0, output=FORCE_OUTPUTS[1])
    graph.apply("ReduceMax", value, axes=[1, 2], keepdims=0, output=FORCE_OUTPUTS[2])


FARTHEST = -60.0
"""Bound of an exponent, which avoids subnormal numbers; they are slow."""


@dataclass(frozen=True)
class KnownForce:
    """Names of likelihoods, (batch, 1, N)."""

    known: str
    """Likelihoods of the known force, up to a factor."""
    tails: str
    """Likelihoods of the tails, up to the same factor."""


def known_force(graph: Graph, known_n: float, found: Scored, root: str) -> KnownForce:
    """Return the likelihoods of each cell; they are yet to be multiplied by exp(-R)."""
    forces = forces_of((known_n, known_n))
    ends, offset = _offset(graph, forces, root, found.force)
    stated = _densities(forces, ends)[None] / forces[1].share
    tails = _weighted(graph, graph.apply("Erf", offset), stated * np.sqrt(np.pi) / 2)
    square = graph.apply("Mul", offset, offset)
    distance = graph.apply("MatMul", graph.constant(-(ends == known_n)[None].astype(np.float64)), square)
    tails = graph.apply("Div", tails, root)
    return KnownForce(graph.apply("Exp", graph.apply("Max", distance, graph.constant(FARTHEST))), tails)


def state_known_force(graph: Graph, known_n: float, scored: Scored, posterior: str, likely: KnownForce) -> None:
    """Add the known force, or the one that the sample shows instead, and its interval."""
    axis, known = graph.ints(2), graph.constant(known_n)

    def mean_of(values: str, weights: str) -> str:
        return graph.apply("ReduceSum", graph.apply("Mul", weights, values), axis, keepdims=1)

    other = graph.apply("Div", likely.tails, graph.apply("Add", likely.known, likely.tails))
    tails = graph.apply("Mul", posterior, other)
    beyond = graph.apply("Sub", scored.force, known)
    # From the known force on, where there is most of the mass.
    mean = mean_of(beyond, tails)
    off = graph.apply("Sub", beyond, mean)
    square = graph.apply("Mul", off, off)
    square = graph.apply("Add", square, graph.apply("Div", graph.constant(0.5), scored.precision))
    part = graph.apply("ReduceSum", tails, axis, keepdims=1)
    at_known = graph.apply("Mul", graph.apply("Mul", mean, mean), graph.apply("Sub", graph.constant(1.0), part))
    variance = graph.apply("Add", mean_of(square, tails), graph.apply("Max", at_known, graph.constant(0.0)))
    both = np.array([0.0, -NORMAL_975, NORMAL_975])
    value = graph.apply("Mul", graph.apply("Sqrt", variance), graph.constant(both))
    value = graph.apply("Add", graph.apply("Add", mean, known), value)
    value = graph.apply("Clip", value, graph.constant(0.0), graph.constant(MAX_FORCE_RATIO * known_n))
    for name, result in zip(FORCE_OUTPUTS, graph.split(value, 3, 2), strict=True):
        graph.apply("Squeeze", result, graph.ints(1, 2), output=name)
