"""The posterior of a contact whose force is known, with tails for any other force; see `graph` for the symbols.

Each cell holds two possibilities: the known force F, whose likelihood is exp(-a_i (F - f_i)^2) exp(-R_i), and a force
from the tails of the prior, whose likelihood is m_i exp(-R_i).
"""

from dataclasses import dataclass

import numpy as np

from beamtouch_models.accuracy.forces import MAX_FORCE_RATIO
from beamtouch_models.estimators.onnx_graph import Graph
from beamtouch_models.estimators.posterior.force import known_and_tails
from beamtouch_models.estimators.posterior.scoring import Scored
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


def known_force(graph: Graph, known_n: float, found: Scored, root: str) -> KnownForce:
    """Return the likelihoods of each cell; they are yet to be multiplied by exp(-R)."""
    distance, tails = known_and_tails(graph, known_n, root, found.force)
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
