"""Priors of the shipped scenes for tests of the posterior, and running its graph."""

import dataclasses
from functools import lru_cache

import numpy as np
import onnx
import onnxruntime as ort
from numpy.typing import NDArray
from onnx import TensorProto, helper, numpy_helper

from beamtouch_models.accuracy.prior import Prior
from beamtouch_models.arrays import Floats
from beamtouch_models.estimators.posterior.graph import posterior_graph
from beamtouch_models.export import to_bytes
from beamtouch_models.metadata import INPUTS
from beamtouch_models.physics.beam import max_deflection_mm
from beamtouch_models.placement import place
from beamtouch_models.scene import load_scene
from beamtouch_models.session import runner, session_options
from example_scenes import SCENES


@lru_cache
def prior_of(name: str, sensors: int, noise_percent: float, *, known: bool) -> Prior:
    """Prior of a shipped scene with so many sensors; `noise_percent` of the largest deflection."""
    scene, _ = load_scene(SCENES / f"{name}.toml")
    low, high = scene.contact.force_range_n
    force = (high, high) if known else (min(low, high / 10), high)
    contact = scene.contact.model_copy(update={"force_n": force})
    scene = scene.model_copy(update={"contact": contact})
    positions = np.array(place(scene, sensors, 1).positions_mm)
    return Prior.of(scene, positions, max_deflection_mm(scene) * noise_percent / 100)


def with_floor(prior: Prior) -> Prior:
    """The prior with the errors of gain and zero that a scene has by default, behind a mean of four readings."""
    return dataclasses.replace(prior, gain=0.003, zero_mm=0.4 * prior.noise_mm)


def answers_of(
    graph: onnx.ModelProto, prior: Prior, deflection_mm: Floats, valid: NDArray[np.bool_] | None = None
) -> dict[str, Floats]:
    """Answers in float64 to deflections (samples, channels) with the prior's own noise and floor."""
    present = np.ones(deflection_mm.shape, np.bool_) if valid is None else valid
    reading = np.where(present, deflection_mm, 0.0)
    with np.errstate(over="ignore"):
        found = runner(to_bytes(graph))(reading, prior.whitening(np.clip(reading, -1e30, 1e30), present))
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
    nodes = list(double.graph.node)
    del double.graph.node[:]
    for node in nodes:
        # onnxruntime has erf for float32 only.
        if node.op_type == "Erf":
            single, result = f"{node.input[0]}_single", node.output[0]
            double.graph.node.append(helper.make_node("Cast", [node.input[0]], [single], to=TensorProto.FLOAT))
            double.graph.node.append(helper.make_node("Erf", [single], [f"{single}_erf"]))
            double.graph.node.append(helper.make_node("Cast", [f"{single}_erf"], [result], to=TensorProto.DOUBLE))
        else:
            double.graph.node.append(node)
    for value in (*double.graph.input, *double.graph.output):
        if value.type.tensor_type.elem_type == TensorProto.FLOAT:
            value.type.tensor_type.elem_type = TensorProto.DOUBLE
    return double


def double_answers(graph: onnx.ModelProto, prior: Prior, deflection_mm: Floats) -> dict[str, Floats]:
    """Answers of the same graph computed in float64, to the same inputs as float32 gives."""
    content = to_bytes(in_double(graph))
    session = ort.InferenceSession(content, session_options(), providers=["CPUExecutionProvider"])
    names = [output.name for output in session.get_outputs()]
    inputs = deflection_mm, prior.whitening(deflection_mm)
    rounded = [values.astype(np.float32).astype(np.float64) for values in inputs]
    return dict(zip(names, session.run(None, dict(zip(INPUTS, rounded, strict=True))), strict=True))
