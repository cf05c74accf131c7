"""The small network as an ONNX graph, with its scaling folded into its weights.

Each operation costs about as much as all the arithmetic of this network, so the graph has as few as possible.
"""

import numpy as np
import onnx

from beamtouch_models.arrays import Floats
from beamtouch_models.estimators.onnx_graph import Graph, model
from beamtouch_models.estimators.small_network import ODDS_SCALE, Network
from beamtouch_models.metadata import FORCE_OUTPUTS, INPUTS, POSITION_OUTPUTS


def small_network_graph(network: Network, *, with_force: bool) -> onnx.ModelProto:
    """Return the network as an ONNX model, without metadata.

    It takes from the whitening which channels are missing, and nothing else. So it gives neither an interval nor log
    odds, which would hold for one noise only.
    """
    graph = Graph()
    (first, *others), inputs = network.layers, network.inputs
    features, log_size = _features(graph, inputs.noise_mm)
    value = graph.apply("Gemm", features, *map(graph.constant, _on_plain_features(network, *first)))
    for weights, bias in (*others[:-1], _in_units(network, *others[-1])):
        value = graph.apply("Tanh", value)
        value = graph.apply("Gemm", value, graph.constant(weights), graph.constant(bias))
    position, force = (graph.apply("Gather", value, graph.index(column), axis=1) for column in (0, 4))
    low, high = (graph.constant(end) for end in network.position_mm)
    graph.apply("Clip", position, low, high, output=POSITION_OUTPUTS[0])
    if not with_force:
        return model(graph, len(inputs.centre), POSITION_OUTPUTS[:1])
    low, high = (graph.constant(end) for end in network.force_n)
    log_force = graph.apply("Add", force, graph.apply("Squeeze", log_size, graph.ints(1)))
    graph.apply("Clip", graph.apply("Exp", log_force), low, high, output=FORCE_OUTPUTS[0])
    return model(graph, len(inputs.centre), (POSITION_OUTPUTS[0], FORCE_OUTPUTS[0]))


def _features(graph: Graph, noise_mm: float) -> tuple[str, str]:
    """Return direction, logarithm of the size and validity, (batch, 2 channels + 1), and the logarithm alone.

    The size is the length of the deflection together with the noise, in mm: sqrt(|z|^2 + s^2).
    """
    deflection, whitening = INPUTS
    weight = graph.apply("ReduceSumSquare", whitening, axes=[1], keepdims=0)
    valid = graph.apply("Greater", weight, graph.constant(0.0))
    reading = graph.apply("Where", valid, deflection, graph.constant(0.0))
    square = graph.apply("ReduceSumSquare", reading, axes=[1], keepdims=1)
    square = graph.apply("Add", square, graph.constant(noise_mm**2))
    direction = graph.apply("Div", reading, graph.apply("Sqrt", square))
    log_size = graph.apply("Mul", graph.apply("Log", square), graph.constant(0.5))
    return graph.apply("Concat", direction, log_size, graph.cast(valid, np.float32), axis=1), log_size


def _on_plain_features(network: Network, weights: Floats, bias: Floats) -> tuple[Floats, Floats]:
    """Return the first layer for plain features: not centred, turned or scaled, and valid instead of missing."""
    inputs, channels = network.inputs, len(network.inputs.centre)
    direction, log_size, missing = weights[:channels], weights[channels : channels + 1], weights[channels + 1 :]
    turned, scaled = inputs.axes @ direction, log_size / inputs.log_spread
    shift = -inputs.centre @ turned - ((np.log(inputs.noise_mm) + inputs.log_centre) * scaled)[0] + missing.sum(axis=0)
    return np.concatenate([turned, scaled, -missing]), bias + shift


def _in_units(network: Network, weights: Floats, bias: Floats) -> tuple[Floats, Floats]:
    """Return the last layer with outputs in mm, in nats, and as log of the force in N minus log of the size in mm."""
    centre, half = network.position_scale
    factor = np.array([half, 1, 1, ODDS_SCALE, 1, 1, 1])
    width = np.log(np.array(network.width) * [half, 1.0])
    shift = np.array([centre, width[0], width[0], 0, -np.log(network.inputs.noise_mm), width[1], width[1]])
    return weights * factor, bias * factor + shift
