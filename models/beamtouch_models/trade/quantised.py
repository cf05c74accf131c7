"""Quantisation of a graph's weights to 8 bits."""

import logging
import tempfile
from pathlib import Path

import onnx
from onnxruntime.quantization import QuantType, quantize_dynamic


def quantised(graph: onnx.ModelProto) -> onnx.ModelProto:
    """Return the graph with the weights of its float32 products as int8; their inputs are quantised at run time."""
    before = logging.root.manager.disable
    logging.disable(logging.WARNING)  # each call recommends a step that this graph does not need
    try:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "quantised.onnx"
            # Not the tables of `Gather`: they are physics, not weights.
            quantize_dynamic(graph, path, weight_type=QuantType.QInt8, op_types_to_quantize=["MatMul", "Gemm"])
            made: onnx.ModelProto = onnx.load(path)
    finally:
        logging.disable(before)
    return made
