"""ONNX graphs with the inputs and outputs of a model file.

Opset and IR version are pinned to what onnxruntime 1.17 reads, so that a model made today runs on a machine that is not
updated.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import onnx
from numpy.typing import ArrayLike, DTypeLike
from onnx import TensorProto, helper, numpy_helper

from beamtouch_models.modelfile import INPUTS

OPSET = 17
IR_VERSION = 8


@dataclass
class Graph:
    """Nodes and constants of a graph under construction; every operation returns the name of its result."""

    real: DTypeLike = np.float32
    """Of constants, unless they state another."""
    nodes: list[onnx.NodeProto] = field(default_factory=list)
    constants: list[onnx.TensorProto] = field(default_factory=list)

    def constant(self, value: ArrayLike, kind: DTypeLike | None = None) -> str:
        """Add a constant."""
        name = f"constant_{len(self.constants)}"
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
        """Add an operation with one result."""
        name = output or f"{operation.lower()}_{len(self.nodes)}"
        node = helper.make_node(operation, inputs, [name])
        node.attribute.extend(helper.make_attribute(key, value) for key, value in sorted(attributes.items()))
        self.nodes.append(node)
        return name

    def cast(self, value: str, kind: DTypeLike) -> str:
        """Convert to another number type."""
        return self.apply("Cast", value, to=int(helper.np_dtype_to_tensor_dtype(np.dtype(kind))))

    def split(self, value: str, parts: int, axis: int) -> list[str]:
        """Cut into equal parts along an axis."""
        names = [f"part_{len(self.nodes)}_{part}" for part in range(parts)]
        self.nodes.append(helper.make_node("Split", [value], names, axis=axis))
        return names


def model(graph: Graph, channels: int, outputs: Sequence[str]) -> onnx.ModelProto:
    """Return a graph that computes `outputs` as an ONNX model without metadata; raises where it is not valid ONNX."""
    deflection, valid = INPUTS
    proto = helper.make_graph(
        graph.nodes,
        "beamtouch",
        [
            helper.make_tensor_value_info(deflection, TensorProto.FLOAT, ["batch", channels]),
            helper.make_tensor_value_info(valid, TensorProto.BOOL, ["batch", channels]),
        ],
        [helper.make_tensor_value_info(name, TensorProto.FLOAT, ["batch"]) for name in outputs],
        graph.constants,
    )
    made = helper.make_model(proto, opset_imports=[helper.make_opsetid("", OPSET)], producer_name="beamtouch")
    made.ir_version = IR_VERSION
    onnx.checker.check_model(made)
    return made
