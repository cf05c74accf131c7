"""The posterior of a contact whose force is known, with tails for any other force; see `graph` for the symbols.

Each cell holds two possibilities: the known force F, whose likelihood is exp(-Q_i), Q_i = R_i + a_i (F - f_i)^2, and a
force from the tails of the prior, whose likelihood is m_i exp(-R_i). Where cells are wider than the posterior, each is
tempered by its own width: a contact of the known force moves the size of the reading as well as its direction.
Tempering flattens a likelihood far from its top, too. So it applies to what lies above the lowest Q and R over the
position, and these lowest values weigh the known force against the tails as they are.
"""

from dataclasses import dataclass

import numpy as np

from beamtouch_models.accuracy.forces import MAX_FORCE_RATIO
from beamtouch_models.estimators.onnx_graph import Graph
from beamtouch_models.estimators.posterior.force import WIDER, known_and_tails
from beamtouch_models.estimators.posterior.scoring import FLATTEST, Lowest, Scored
from beamtouch_models.estimators.posterior.tempering import Tempered
from beamtouch_models.metadata import FORCE_OUTPUTS
from beamtouch_models.quantiles import NORMAL_975

FARTHEST = -60.0
"""Bound of an exponent, which avoids subnormal numbers; they are slow."""


@dataclass(frozen=True)
class KnownForce:
    """Names of likelihoods, (batch, 1, N)."""

    known: str
    """Likelihoods of the known force, up to a factor."""
    tails: str
    """Likelihoods of the tails, up to the same factor."""


def known_force(
    graph: Graph, known_n: float, found: Scored, root: str, lowest: Lowest, widened: Tempered | None
) -> KnownForce:
    """Return the likelihoods of each cell; untempered, they are yet to be multiplied by exp(-R)."""
    distance, tails = known_and_tails(graph, known_n, root, found.force)
    if widened is None:
        return KnownForce(_bounded_exp(graph, distance), tails)
    misfit = graph.apply("Sub", found.misfit, distance)
    cell = graph.apply("ReduceMin", misfit, axes=[2], keepdims=1)
    lowest_r = graph.apply("Mul", lowest.twice, graph.constant(0.5))
    worse = graph.apply("Sub", lowest_r, _lowest_misfit(graph, known_n, found, widened.change))
    # No place explains a sample better with the known force than with the best one, but for rounding.
    worse = graph.apply("Min", worse, graph.constant(0.0))
    known = _widened(graph, misfit, cell, widened.widening, worse)
    above = _widened(graph, found.misfit, lowest.cell, widened.turning, None)
    return KnownForce(known, graph.apply("Mul", tails, above))


def _lowest_misfit(graph: Graph, known_n: float, found: Scored, change: str) -> str:
    """Return the smallest Q over the position, (batch, 1, 1); within a cell the reading changes along a line."""
    left = graph.apply("Sub", found.own, graph.apply("Mul", found.shape, graph.constant(known_n)))
    along = graph.apply("ReduceSum", graph.apply("Mul", left, change), graph.ints(1), keepdims=1)
    square = graph.apply("Max", graph.apply("ReduceSumSquare", change, axes=[1], keepdims=1), graph.constant(FLATTEST))
    # H and y are over the root of 2, the change is not. A cell ends half of its change from the middle.
    end = 0.5 / np.sqrt(2)
    place = graph.apply("Clip", graph.apply("Div", along, square), graph.constant(-end), graph.constant(end))
    left = graph.apply("Sub", left, graph.apply("Mul", place, change))
    return graph.apply("ReduceMin", graph.apply("ReduceSumSquare", left, axes=[1], keepdims=1), axes=[2], keepdims=1)


def _bounded_exp(graph: Graph, exponent: str) -> str:
    return graph.apply("Exp", graph.apply("Max", exponent, graph.constant(FARTHEST)))


def _widened(graph: Graph, misfit: str, least: str, widening: str, worse: str | None) -> str:
    """Return a likelihood of the integral that it has untempered, times exp(`worse`)."""
    exponent = graph.apply("Div", graph.apply("Sub", least, misfit), widening)
    exponent = graph.apply("Add", exponent, worse) if worse else exponent
    return graph.apply("Div", _bounded_exp(graph, exponent), graph.apply("Sqrt", widening))


def state_known_force(
    graph: Graph, known_n: float, scored: Scored, posterior: str, other: str, contraction: str | None
) -> None:
    """Add the known force, or the one that the sample shows instead, and its interval.

    `other` is the part of each cell that the tails have.
    """
    axis, known = graph.ints(2), graph.constant(known_n)

    def mean_of(values: str, weights: str) -> str:
        return graph.apply("ReduceSum", graph.apply("Mul", weights, values), axis, keepdims=1)

    tails = graph.apply("Mul", posterior, other)
    beyond = graph.apply("Sub", scored.force, known)
    # From the known force on, where there is most of the mass.
    mean = mean_of(beyond, tails)
    off = graph.apply("Sub", beyond, mean)
    square = graph.apply("Mul", off, off)
    square = graph.apply("Mul", square, contraction) if contraction else square
    square = graph.apply("Add", square, graph.apply("Div", graph.constant(0.5), scored.precision))
    part = graph.apply("ReduceSum", tails, axis, keepdims=1)
    at_known = graph.apply("Mul", graph.apply("Mul", mean, mean), graph.apply("Sub", graph.constant(1.0), part))
    variance = graph.apply("Add", mean_of(square, tails), graph.apply("Max", at_known, graph.constant(0.0)))
    both = np.array([0.0, -NORMAL_975, NORMAL_975]) * (WIDER if contraction else 1.0)
    value = graph.apply("Mul", graph.apply("Sqrt", variance), graph.constant(both))
    value = graph.apply("Add", graph.apply("Add", mean, known), value)
    value = graph.apply("Clip", value, graph.constant(0.0), graph.constant(MAX_FORCE_RATIO * known_n))
    for name, result in zip(FORCE_OUTPUTS, graph.split(value, 3, 2), strict=True):
        graph.apply("Squeeze", result, graph.ints(1, 2), output=name)
