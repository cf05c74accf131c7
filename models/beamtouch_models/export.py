"""A trained network as an ONNX graph, and the graph with its metadata as the one model file.

Opset and IR version are pinned to what onnxruntime 1.17 reads, so that a model made today runs on a machine that is not
updated.
"""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import onnx
from numpy.typing import NDArray
from onnx import TensorProto, helper, numpy_helper

from beamtouch_models.modelfile import FORCE_OUTPUTS, POSITION_OUTPUTS, Metadata
from beamtouch_models.network import Network

OPSET = 17
IR_VERSION = 8


@dataclass
class _Graph:
    """Nodes and constants of a graph under construction; every operation returns the name of its result."""

    nodes: list[onnx.NodeProto] = field(default_factory=list)
    constants: list[onnx.TensorProto] = field(default_factory=list)

    def constant(self, value: NDArray[np.generic] | np.int64 | float) -> str:
        array = np.asarray(value, np.float32) if isinstance(value, float) else np.asarray(value)
        name = f"constant_{len(self.constants)}"
        self.constants.append(numpy_helper.from_array(array, name))
        return name

    def apply(self, operation: str, *inputs: str, output: str | None = None, **attributes: int) -> str:
        name = output or f"{operation.lower()}_{len(self.nodes)}"
        node = helper.make_node(operation, inputs, [name])
        node.attribute.extend(helper.make_attribute(key, value) for key, value in attributes.items())
        self.nodes.append(node)
        return name

    def scaled(self, value: str, factor: float, offset: float = 0.0, output: str | None = None) -> str:
        product = self.apply("Mul", value, self.constant(factor))
        return self.apply("Add", product, self.constant(offset), output=output)


def network_graph(network: Network, *, with_force: bool) -> onnx.ModelProto:
    """Return the network as an ONNX model with the inputs and outputs of a model file, without metadata."""
    graph = _Graph()
    features, log_length = _features(graph, network)
    raw = _layers(graph, network, features)
    columns = [graph.apply("Gather", raw, graph.constant(np.int64(index)), axis=1) for index in range(7)]
    _position_outputs(graph, network, columns)
    graph.apply("Identity", columns[3], output="contact_log_odds")
    outputs = list(POSITION_OUTPUTS)
    if with_force:
        _force_outputs(graph, network, columns[4:], log_length)
        outputs += FORCE_OUTPUTS
    return _model(graph, len(network.inputs.centre), outputs)


def _features(graph: _Graph, network: Network) -> tuple[str, str]:
    """Return the input of the first layer and the logarithm of the deflection's length; as `Inputs.features`."""
    inputs = network.inputs
    known = graph.apply("Where", "valid", "deflection_mm", graph.constant(0.0))
    scaled = graph.apply("Div", known, graph.constant(inputs.noise_mm))
    square = graph.apply("Mul", scaled, scaled)
    total = graph.apply("ReduceSum", square, graph.constant(np.array([1], np.int64)), keepdims=1)
    length = graph.apply("Sqrt", graph.apply("Add", total, graph.constant(1.0)))
    direction = graph.apply("Sub", graph.apply("Div", scaled, length), graph.constant(inputs.centre))
    turned = graph.apply("MatMul", direction, graph.constant(inputs.axes))
    log_length = graph.apply("Log", length)
    log_scaled = graph.scaled(log_length, 1 / inputs.log_spread, -inputs.log_centre / inputs.log_spread)
    missing = graph.apply("Cast", graph.apply("Not", "valid"), to=TensorProto.FLOAT)
    features = graph.apply("Concat", turned, log_scaled, missing, axis=1)
    return features, graph.apply("Squeeze", log_length, graph.constant(np.array([1], np.int64)))


def _layers(graph: _Graph, network: Network, features: str) -> str:
    value = features
    for weights, bias in network.layers[:-1]:
        value = graph.apply("Tanh", graph.apply("Gemm", value, graph.constant(weights), graph.constant(bias)))
    weights, bias = network.layers[-1]
    return graph.apply("Gemm", value, graph.constant(weights), graph.constant(bias))


def _interval(graph: _Graph, columns: list[str], width: float) -> tuple[str, str, str]:
    """Lower end, median and upper end from the three raw outputs."""
    median, below, above = columns
    low = graph.apply("Sub", median, graph.scaled(graph.apply("Softplus", below), width))
    high = graph.apply("Add", median, graph.scaled(graph.apply("Softplus", above), width))
    return low, median, high


def _position_outputs(graph: _Graph, network: Network, columns: list[str]) -> None:
    low, median, high = _interval(graph, columns[:3], network.width[0])
    centre, half = network.position_scale
    ends = [graph.constant(float(end)) for end in network.position_mm]
    for value, name in ((median, "position_mm"), (low, "position_low_mm"), (high, "position_high_mm")):
        graph.apply("Clip", graph.scaled(value, half, centre), *ends, output=name)


def _force_outputs(graph: _Graph, network: Network, columns: list[str], log_length: str) -> None:
    low, median, high = _interval(graph, columns, network.width[1])
    ends = [graph.constant(float(end)) for end in network.force_n]
    for value, name in ((median, "force_n"), (low, "force_low_n"), (high, "force_high_n")):
        graph.apply("Clip", graph.apply("Exp", graph.apply("Add", value, log_length)), *ends, output=name)


def _model(graph: _Graph, channels: int, outputs: list[str]) -> onnx.ModelProto:
    proto = helper.make_graph(
        graph.nodes,
        "beamtouch",
        [
            helper.make_tensor_value_info("deflection_mm", TensorProto.FLOAT, ["batch", channels]),
            helper.make_tensor_value_info("valid", TensorProto.BOOL, ["batch", channels]),
        ],
        [helper.make_tensor_value_info(name, TensorProto.FLOAT, ["batch"]) for name in outputs],
        graph.constants,
    )
    model = helper.make_model(proto, opset_imports=[helper.make_opsetid("", OPSET)], producer_name="beamtouch")
    model.ir_version = IR_VERSION
    onnx.checker.check_model(model)
    return model


def to_bytes(model: onnx.ModelProto, metadata: Metadata | None = None) -> bytes:
    """Serialise a graph, with its metadata; the same input gives the same bytes."""
    complete = onnx.ModelProto()
    complete.CopyFrom(model)
    for key, text in sorted((metadata.to_entries() if metadata else {}).items()):
        complete.metadata_props.add(key=key, value=text)
    content: bytes = complete.SerializeToString(deterministic=True)
    return content


def write_whole(path: Path, content: bytes) -> None:
    """Write a file so that it is either there as a whole or not at all."""
    partial = path.with_name(path.name + ".partial")
    try:
        partial.write_bytes(content)
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)
