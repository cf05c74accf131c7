"""Real model files, small enough to compute by hand."""

from functools import cache
from pathlib import Path
from typing import TypedDict, Unpack

import numpy as np
import onnx
import onnxruntime
from onnx import TensorProto, helper

from beamtouch_common.outline import names_of
from beamtouch_models import runtime
from beamtouch_models.runtime import ModelFile
from beamtouch_models.runtime.metadata import (
    CORRELATION_OUTPUT,
    EVIDENCE_OUTPUTS,
    FORCE_OUTPUTS,
    POSITION_OUTPUTS,
    Metadata,
)
from beamtouch_models.runtime.metadata_parts import (
    Accuracy,
    BeamDrawing,
    Channel,
    DrawnSupport,
    FilterChoice,
    Floor,
    Golden,
    Influence,
    LayoutErrors,
    Noise,
    Ranges,
    Sensor,
    SmallestForce,
    Thresholds,
)

Rows = list[list[float]]
BEAM = "beam-1"
"""Identity of the beam of these models, unless a test gives another."""


def _place(axis: str, value: str) -> dict[str, onnx.NodeProto]:
    low, high = f"{axis}_low_mm", f"{axis}_high_mm"
    return {
        f"{axis}_mm": helper.make_node("Identity", [value], [f"{axis}_mm"]),
        low: helper.make_node("Sub", [value, "one"], [low]),
        high: helper.make_node("Add", [value, "one"], [high]),
    }


def _graph(
    channels: int, outputs: tuple[str, ...], spoiled: str, force_n_per_mm: float, misfit_per_mm: float
) -> onnx.ModelProto:
    """position or x = 100 + 100 * (0 d1 + 1 d2 + 2 d3 ...), y half of that; intervals +-1; correlation = sum / 2.

    Log odds = 100 * sum (touch: 10), force = `force_n_per_mm` (10) * sum.

    The misfit is `misfit_per_mm` (1000) * (d3 - d2) where that is positive: s3 is not above s2 in a contact.
    A channel that is not valid counts as zero. Where the sum is exactly 2, the output `spoiled` is a division by zero.
    """
    nan_at_two = f"{spoiled}_everywhere"
    weights = np.arange(channels, dtype=np.float32).reshape(-1, 1) * 100
    order = np.array([0, -misfit_per_mm, misfit_per_mm, *[0] * channels], np.float32)[:channels] * (channels > 2)
    constants = {
        "order": order.reshape(-1, 1).astype(np.float32),
        "zero": np.float32(0),
        "one": np.float32(1),
        "two": np.float32(2),
        "force_per_mm": np.float32(force_n_per_mm),
        "hundred": np.float32(100),
        "axis": np.array([1], np.int64),
        "weights": weights,
    }
    figures = {
        **_place("position", "raised"),
        **_place("x", "raised"),
        **_place("y", "beside"),
        "place_correlation": helper.make_node("Div", ["total", "two"], ["place_correlation"]),
        "contact_log_odds": helper.make_node("Mul", ["total", "hundred"], ["contact_log_odds"]),
        "misfit": helper.make_node("Relu", ["excess"], ["misfit"]),
        "force_n": helper.make_node("Identity", ["pushed"], ["force_n"]),
        "force_low_n": helper.make_node("Sub", ["pushed", "one"], ["force_low_n"]),
        "force_high_n": helper.make_node("Add", ["pushed", "one"], ["force_high_n"]),
    }
    nodes = [
        helper.make_node("ReduceSumSquare", ["whitening_per_mm"], ["weight"], axes=[1], keepdims=0),
        helper.make_node("Greater", ["weight", "zero"], ["valid"]),
        helper.make_node("Where", ["valid", "deflection_mm", "zero"], ["d"]),
        helper.make_node("ReduceSum", ["d", "axis"], ["total"], keepdims=0),
        helper.make_node("MatMul", ["d", "weights"], ["moment"]),
        helper.make_node("MatMul", ["d", "order"], ["above"]),
        helper.make_node("Squeeze", ["above", "axis"], ["excess"]),
        helper.make_node("Squeeze", ["moment", "axis"], ["shift"]),
        helper.make_node("Add", ["shift", "hundred"], ["raised"]),
        helper.make_node("Div", ["raised", "two"], ["beside"]),
        helper.make_node("Mul", ["total", "force_per_mm"], ["pushed"]),
        helper.make_node("Sub", ["total", "two"], ["to_two"]),
        helper.make_node("Div", ["to_two", "to_two"], ["unity"]),
        *[figures[name] for name in outputs],
    ]
    if spoiled in outputs:
        figures[spoiled].output[0] = nan_at_two
        nodes.append(helper.make_node("Div", [nan_at_two, "unity"], [spoiled]))
    graph = helper.make_graph(
        nodes,
        "tiny",
        [
            helper.make_tensor_value_info("deflection_mm", TensorProto.FLOAT, ["batch", channels]),
            helper.make_tensor_value_info("whitening_per_mm", TensorProto.FLOAT, ["batch", channels, channels]),
        ],
        [helper.make_tensor_value_info(name, TensorProto.FLOAT, ["batch"]) for name in outputs],
        [onnx.numpy_helper.from_array(np.asarray(value), name) for name, value in constants.items()],
    )
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)


def _golden(model: onnx.ModelProto, channels: int) -> Golden:
    deflection: Rows = [[0.1] * channels, [0.0] * channels]
    whitening = (np.eye(channels) * 100).tolist()
    session = onnxruntime.InferenceSession(model.SerializeToString(), providers=["CPUExecutionProvider"])
    values = session.run(
        None,
        {
            "deflection_mm": np.array(deflection, np.float32),
            "whitening_per_mm": np.array([whitening] * 2, np.float32),
        },
    )
    names = [output.name for output in session.get_outputs()]
    answers = {name: [float(one) for one in value] for name, value in zip(names, values, strict=True)}
    return Golden(deflection_mm=deflection, whitening_per_mm=[whitening] * 2, answers=answers)


_SUPPORTS = [
    DrawnSupport(at_mm=0, across_mm=0, kind="spring", slides=False),
    DrawnSupport(at_mm=400, across_mm=0, kind="simple", slides=False),
    DrawnSupport(at_mm=0, across_mm=290, end_mm=(400, 290), kind="simple", slides=False),
]


@cache
def _content(  # noqa: PLR0913, PLR0917  # its key in the cache
    name: str,
    channels: int,
    min_channels: int,
    outputs: tuple[str, ...],
    prefix: str,
    beam: str,
    spoiled: str,
    force_n_per_mm: float,
    misfit_per_mm: float,
    noise_mm: float,
) -> bytes:
    model, is_plate = _graph(channels, outputs, spoiled, force_n_per_mm, misfit_per_mm), "y_mm" in outputs
    places = 25 if is_plate else 9
    metadata = Metadata(
        name=name,
        beam=beam,
        estimator="tiny",
        length_mm=400,
        axes=["x", "y"] if is_plate else ["position"],
        width_mm=300 if is_plate else None,
        layout=[
            Channel(
                name=f"{prefix}{i + 1}",
                position_mm=min(100.0 * (i + 1), 400.0),
                across_mm=50.0 + 100.0 * (i % 3) if is_plate else None,
            )
            for i in range(channels)
        ],
        min_channels=min_channels,
        ranges=Ranges(position_mm=(1, 399), across_mm=(1, 299) if is_plate else None, force_n=(1, 20)),
        max_deflection_mm=1,
        noise=Noise(reading_mm=noise_mm, sample_mm=noise_mm),
        filter=FilterChoice(),
        sensor=Sensor(rate_hz=200, range_mm=(1, 4), standoff_mm=3, adc_bits=12, gain_mm_per_count=0.001, offset_mm=0),
        floor=Floor(gain=[0.003] * channels, zero_mm=[0.002] * channels),
        thresholds=Thresholds(
            touch=[10.0] * channels,
            rest=[30.0] * channels,
            misfit=[1e6, 1e6, *[30.0] * channels][:channels],
            false_contacts_per_day=1 / 30,
        ),
        smallest_force=SmallestForce(position_mm=[200.0], across_mm=[150.0] if is_plate else None, force_n=[0.5]),
        drawn=BeamDrawing(
            supports=_SUPPORTS if is_plate else [],
            at_mm=[0.0, 400.0],
            load_mm=[200.0],
            deflection_mm_per_n=[[0.0, 0.0]],
            sensor_mm=8.0,
        ),
        influence=Influence(
            mm_per_n=[[0.01 * (1 + (place + 3 * i) % 7) for i in range(channels)] for place in range(places)],
        ),
        placed=LayoutErrors(
            criterion="position-error", failed_percent=10.0, limit_without_percent=[], limit_without_standard_error=[]
        ),
        seed=1,
        accuracy=Accuracy(
            error_percent=1,
            error_standard_error=0.1,
            limit_percent=1,
            limit_standard_error=0.1,
            ratio_standard_error=0.1,
            since_touch=[],
        ),
        golden=_golden(model, channels),
        scene="",
    )
    helper.set_model_props(model, metadata.to_entries())
    content: bytes = model.SerializeToString()
    return content


PLATE_OUTPUTS = (
    *(*names_of("x", "mm"), *names_of("y", "mm"), CORRELATION_OUTPUT),
    *(*EVIDENCE_OUTPUTS, *FORCE_OUTPUTS),
)
"""Outputs of a model of two axes, on a plate of 400 by 300 mm."""


class ModelOptions(TypedDict, total=False):
    """What `model_of` and `write_model` take beside the name."""

    channels: int
    min_channels: int
    outputs: tuple[str, ...]
    prefix: str
    beam: str
    spoiled: str
    force_n_per_mm: float
    misfit_per_mm: float
    noise_mm: float


def content_of(name: str = "press-7", **options: Unpack[ModelOptions]) -> bytes:
    """Return a model file with channels s1, s2, ... (or of another prefix) on a beam of 400 mm."""
    return _content(
        name,
        options.get("channels", 3),
        options.get("min_channels", 2),
        options.get("outputs", POSITION_OUTPUTS + FORCE_OUTPUTS),
        options.get("prefix", "s"),
        options.get("beam", BEAM),
        options.get("spoiled", "position_mm"),
        options.get("force_n_per_mm", 10.0),
        options.get("misfit_per_mm", 1000.0),
        options.get("noise_mm", 0.01),
    )


def model_of(name: str = "press-7", **options: Unpack[ModelOptions]) -> ModelFile:
    """Return such a model, loaded once for all tests."""
    return _loaded(content_of(name, **options))


@cache
def _loaded(content: bytes) -> ModelFile:
    return runtime.load_bytes(content, "small model")


def write_model(folder: Path, name: str = "press-7", **options: Unpack[ModelOptions]) -> Path:
    """Write such a file; return its path."""
    path = folder / f"{name}.onnx"
    path.write_bytes(content_of(name, **options))
    return path
