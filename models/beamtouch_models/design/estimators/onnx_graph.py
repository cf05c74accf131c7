"""ONNX graphs with the inputs and outputs of a model file, and model files as bytes.

Opset and IR version are pinned to those that onnxruntime 1.17 reads, so that new models run on older installations.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import onnx
from numpy.typing import ArrayLike, DTypeLike
from onnx import TensorProto, helper, numpy_helper

from beamtouch_models.arrays import Floats
from beamtouch_models.runtime.error_model import NORMAL_975
from beamtouch_models.runtime.metadata import FORCE_OUTPUTS, INPUTS, Metadata

OPSET = 17
IR_VERSION = 8


@dataclass
class Graph:
    """Nodes and constants of a graph under construction; every operation returns the name of its result."""

    real: DTypeLike = np.float32
    """Number type of constants, unless stated otherwise."""
    name: str = ""
    """Prefix of every name, for joining two graphs."""
    nodes: list[onnx.NodeProto] = field(default_factory=list)
    constants: list[onnx.TensorProto] = field(default_factory=list)

    def constant(self, value: ArrayLike, kind: DTypeLike | None = None) -> str:
        """Add a constant."""
        name = f"{self.name}constant_{len(self.constants)}"
        self.constants.append(numpy_helper.from_array(np.asarray(value, kind or self.real), name))
        return name

    def ints(self, *values: int) -> str:
        """Add a vector of indices or axes."""
        return self.constant(values, np.int64)

    def index(self, value: int) -> str:
        """Add a single index."""
        return self.constant(value, np.int64)

    def apply(
        self, operation: str, *inputs: str, output: str | None = None, **attributes: int | float | Sequence[int]
    ) -> str:
        """Add an operation with one result. A reduced axis keeps a length of 1 unless stated otherwise."""
        if operation.startswith("Reduce"):
            attributes.setdefault("keepdims", 1)
        name = output or f"{self.name}{operation.lower()}_{len(self.nodes)}"
        node = helper.make_node(operation, inputs, [name])
        node.attribute.extend(helper.make_attribute(key, value) for key, value in sorted(attributes.items()))
        self.nodes.append(node)
        return name

    def cast(self, value: str, kind: DTypeLike) -> str:
        """Convert to another number type."""
        return self.apply("Cast", value, to=int(helper.np_dtype_to_tensor_dtype(np.dtype(kind))))

    def top(self, value: str, count: int, axis: int, *, largest: bool) -> tuple[str, str]:
        """Return the `count` largest or smallest values along an axis, the best first, and their indices."""
        name = f"{self.name}top_{len(self.nodes)}"
        names = (name, f"{name}_index")
        inputs = [value, self.ints(count)]
        self.nodes.append(helper.make_node("TopK", inputs, names, axis=axis, largest=int(largest), sorted=1))
        return names

    def split(self, value: str, parts: int, axis: int) -> list[str]:
        """Cut into equal parts along an axis."""
        names = [f"part_{len(self.nodes)}_{part}" for part in range(parts)]
        self.nodes.append(helper.make_node("Split", [value], names, axis=axis))
        return names


def with_linear_input(made: onnx.ModelProto, offset_mm: Floats, curve_per_mm: float) -> onnx.ModelProto:
    """Return the model with corrected inputs: it computes y + curve y^2 with y = measured deflection - offset."""
    if not (np.any(offset_mm) or curve_per_mm):
        return made
    deflection = INPUTS[0]
    before = Graph(name="linear")
    value = before.apply("Sub", deflection, before.constant(offset_mm)) if np.any(offset_mm) else deflection
    if curve_per_mm:
        factor = before.apply("Add", before.apply("Mul", value, before.constant(curve_per_mm)), before.constant(1.0))
        value = before.apply("Mul", value, factor)
    changed = onnx.ModelProto()
    changed.CopyFrom(made)
    for node in changed.graph.node:
        node.input[:] = [value if name == deflection else name for name in node.input]
    nodes = [*before.nodes, *changed.graph.node]
    del changed.graph.node[:]
    changed.graph.node.extend(nodes)
    changed.graph.initializer.extend(before.constants)
    return changed


def with_force_error(made: onnx.ModelProto, error: float) -> onnx.ModelProto:
    """Return the model with wider intervals of the force, by a relative error (standard deviation) of all forces."""
    force, *ends = FORCE_OUTPUTS
    if not (error and force in {output.name for output in made.graph.output}):
        return made
    changed, after = onnx.ModelProto(), Graph(name="scaled")
    changed.CopyFrom(made)
    for node in changed.graph.node:
        for names in (node.input, node.output):
            names[:] = [f"unscaled_{name}" if name in ends else name for name in names]
    scaled = after.apply("Mul", force, after.constant(NORMAL_975 * error))
    for end, back in zip(ends, ("Sub", "Add"), strict=True):
        gap = after.apply("Sub", force, f"unscaled_{end}")
        square = after.apply("Add", after.apply("Mul", gap, gap), after.apply("Mul", scaled, scaled))
        after.apply(back, force, after.apply("Sqrt", square), output=end)
    changed.graph.node.extend(after.nodes)
    changed.graph.initializer.extend(after.constants)
    return changed


def model(graph: Graph, channels: int, outputs: Sequence[str]) -> onnx.ModelProto:
    """Return a graph with these outputs as an ONNX model without metadata; onnx raises if it is invalid."""
    deflection, whitening = INPUTS
    proto = helper.make_graph(
        graph.nodes,
        "beamtouch",
        [
            helper.make_tensor_value_info(deflection, TensorProto.FLOAT, ["batch", channels]),
            helper.make_tensor_value_info(whitening, TensorProto.FLOAT, ["batch", channels, channels]),
        ],
        [helper.make_tensor_value_info(name, TensorProto.FLOAT, ["batch"]) for name in outputs],
        graph.constants,
    )
    made = helper.make_model(proto, opset_imports=[helper.make_opsetid("", OPSET)], producer_name="beamtouch")
    made.ir_version = IR_VERSION
    onnx.checker.check_model(made)
    return made


def to_bytes(model: onnx.ModelProto, metadata: Metadata | None = None) -> bytes:
    """Serialise a graph, with its metadata; the same input gives the same bytes."""
    complete = onnx.ModelProto()
    complete.CopyFrom(model)
    for key, text in sorted((metadata.to_entries() if metadata else {}).items()):
        complete.metadata_props.add(key=key, value=text)
    content: bytes = complete.SerializeToString(deterministic=True)
    return content
