"""The paper's network as an ONNX graph: gives a position only, and needs all channels."""

import numpy as np
import onnx

from beamtouch_models.accuracy.prior import Prior
from beamtouch_models.estimators.onnx_graph import Graph, model
from beamtouch_models.estimators.paper_network import TARGET_HIGH, TARGET_LOW, PaperNetwork, train
from beamtouch_models.metadata import INPUTS

PATTERNS = 399
"""Number of load positions in training, as in the paper."""


def paper_graph(network: PaperNetwork) -> onnx.ModelProto:
    """Return a network as an ONNX model; it ignores its whitening."""
    graph = Graph()
    deflection, _whitening = INPUTS
    weights = 2 * network.hidden[:-1] / network.full_scale_mm[:, None]
    bias = network.hidden[-1] - network.hidden[:-1].sum(axis=0)
    units = graph.apply("Sigmoid", graph.apply("Gemm", deflection, graph.constant(weights), graph.constant(bias)))
    output = graph.apply("Gemm", units, graph.constant(network.output[:-1, None]), graph.constant(network.output[-1:]))
    scale = network.length_mm / (TARGET_HIGH - TARGET_LOW)
    scaled = graph.apply("Mul", graph.apply("Sigmoid", output), graph.constant(scale))
    shifted = graph.apply("Add", scaled, graph.constant(-TARGET_LOW * scale))
    graph.apply("Squeeze", shifted, graph.ints(1), output="position_mm")
    return model(graph, len(network.full_scale_mm), ["position_mm"])


def trained_as_in_the_paper(prior: Prior, seed: int) -> PaperNetwork:
    """Train on deflections without noise, at the middle of the force range, because the paper has a single force."""
    position = np.linspace(*prior.position_mm, PATTERNS)
    force = sum(prior.force_n) / 2
    (network,) = train([force * prior.influence_at(position)], position, prior.length_mm, seed=seed)
    return network
