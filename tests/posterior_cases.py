"""Priors of the shipped scenes for tests of the posterior, and running its graph."""

from functools import lru_cache

import numpy as np
import onnx
import onnxruntime as ort
from numpy.typing import NDArray
from onnx import TensorProto, numpy_helper

from beamtouch_models.accuracy.prior import Prior
from beamtouch_models.arrays import Floats
from beamtouch_models.estimators.posterior.graph import posterior_graph
from beamtouch_models.export import to_bytes
from beamtouch_models.physics.beam import influence_of, max_deflection_mm
from beamtouch_models.placement import place
from beamtouch_models.scene import load_scene
from beamtouch_models.session import runner, session_options
from example_scenes import SCENES
from stated_problems import problem_in


@lru_cache
def prior_of(name: str, sensors: int, noise_percent: float, *, known: bool) -> Prior:
    """Prior of a shipped scene with so many sensors; `noise_percent` of the largest deflection."""
    scene, _ = load_scene(SCENES / f"{name}.toml")
    low, high = scene.contact.force_range_n
    force = (high, high) if known else (min(low, high / 10), high)
    contact = scene.contact.model_copy(update={"force_n": force})
    scene = scene.model_copy(update={"contact": contact})
    positions = np.array(place(*problem_in(scene), sensors, 1).positions_mm)
    return Prior.of(influence_of(scene), positions, max_deflection_mm(scene) * noise_percent / 100)


def answers_of(
    graph: onnx.ModelProto, deflection_mm: Floats, valid: NDArray[np.bool_] | None = None
) -> dict[str, Floats]:
    """Answers in float64 to deflections (samples, channels)."""
    valid = np.ones(deflection_mm.shape, np.bool_) if valid is None else valid
    with np.errstate(over="ignore"):
        found = runner(to_bytes(graph))(deflection_mm.astype(np.float32), valid)
    return {name: values.astype(np.float64) for name, values in found.items()}


def graph_of(prior: Prior) -> onnx.ModelProto:
    """The posterior graph, with force where that is not known."""
    return posterior_graph(prior, with_force=not prior.force_is_known)


def in_double(model: onnx.ModelProto) -> onnx.ModelProto:
    """The same graph with the same weights, every float32 a float64, its inputs and outputs too."""
    double = onnx.ModelProto()
    double.CopyFrom(model)
    for tensor in double.graph.initializer:
        if tensor.data_type == TensorProto.FLOAT:
            values = numpy_helper.to_array(tensor).astype(np.float64)
            tensor.CopyFrom(numpy_helper.from_array(values, tensor.name))
    for attribute in (attribute for node in double.graph.node for attribute in node.attribute):
        if attribute.name == "to" and attribute.i == TensorProto.FLOAT:
            attribute.i = TensorProto.DOUBLE
    for value in (*double.graph.input, *double.graph.output):
        if value.type.tensor_type.elem_type == TensorProto.FLOAT:
            value.type.tensor_type.elem_type = TensorProto.DOUBLE
    return double


def double_answers(graph: onnx.ModelProto, deflection_mm: Floats) -> dict[str, Floats]:
    """Answers of the same graph computed in float64, to the same readings as float32 gives."""
    content = to_bytes(in_double(graph))
    session = ort.InferenceSession(content, session_options(), providers=["CPUExecutionProvider"])
    names = [output.name for output in session.get_outputs()]
    reading = deflection_mm.astype(np.float32).astype(np.float64)
    valid = np.ones(reading.shape, np.bool_)
    return dict(zip(names, session.run(None, {"deflection_mm": reading, "valid": valid}), strict=True))
