"""The loader takes a whole, honest model file and nothing else: `inspect` refuses all others in one line."""

import json
import math
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import helper

from beamtouch_models.runtime import ModelFile
from beamtouch_models.runtime.metadata import FORCE_OUTPUTS, POSITION_OUTPUTS
from support.programs.in_process import Refusal

CALIBRATION = {
    "departures": {"position_offset_mm": [0] * 4, "gain": [1] * 4, "offset_mm": [0] * 3},
    "fitted": [],
    "loads": 10,
    "residual_mm": 0,
    "error_before_mm": 1,
    "error_after_mm": 1,
}
"""Of a model with four channels, and of three of them the offsets."""
GOLDEN = {"deflection_mm": [[0, 0]], "whitening_per_mm": [[[0, 0], [0, 0]]], "answers": {}}
PLACED = {
    "criterion": "position-error",
    "failed_percent": 10.0,
    "limit_without_percent": [1, 1, 1, 1],
    "limit_without_standard_error": [],
}


def test_a_built_model_loads_with_its_metadata(bench: ModelFile) -> None:
    assert bench.metadata.name == "bench"
    assert bench.identity.startswith("bench@")
    assert bench.channels == ["s1", "s2", "s3", "s4"]
    assert [channel.position_mm for channel in bench.metadata.layout] == [68, 156, 244, 332]
    assert bench.outputs == POSITION_OUTPUTS + FORCE_OUTPUTS
    # 20 N in the middle of 400 mm of 210 GPa steel, 25 x 3 mm.
    assert bench.metadata.max_deflection_mm == pytest.approx(20 * 400**3 / (48 * 1.18125e7), rel=1e-9)
    assert bench.metadata.noise.sample_mm == pytest.approx(0.001 * bench.metadata.max_deflection_mm, rel=1e-9)


def test_opset_and_ir_stay_readable_for_onnxruntime_1_17(bench_model: Path) -> None:
    model = onnx.load(bench_model)
    assert (model.opset_import[0].version, model.ir_version) == (17, 8)


def without_metadata(content: bytes) -> bytes:
    model = onnx.load_from_string(content)
    del model.metadata_props[:]
    changed: bytes = model.SerializeToString()
    return changed


DAMAGED = "damaged or not an ONNX file; rebuild it with `design-sensors build`"
FILES: dict[str, tuple[Callable[[bytes], bytes], str]] = {
    "empty": (lambda _content: b"", "the file is empty; build it again with"),
    "a byte": (lambda content: content[:1], DAMAGED),
    "half": (lambda content: content[: len(content) // 2], DAMAGED),
    "nearly whole": (lambda content: content[: -len(content) // 100], DAMAGED),
    "a bad byte in its metadata": (
        lambda content: content.replace(b"beamtouch.length_mm", b"\xffeamtouch.length_mm"),
        DAMAGED,
    ),
    "a bad byte in its graph": (lambda content: content.replace(b"MatMul", b"\xffatMul"), DAMAGED),
    "text": (lambda _content: b"not a model", DAMAGED),
    "another model": (without_metadata, "not a Beamtouch model"),
}


@pytest.mark.parametrize("name", FILES)
def test_a_file_that_is_no_whole_model_is_refused(
    name: str, bench_model: Path, tmp_path: Path, refused: Refusal
) -> None:
    change, said = FILES[name]
    path = tmp_path / "damaged.onnx"
    path.write_bytes(change(bench_model.read_bytes()))
    assert said in refused("inspect", path)


def test_what_is_no_file_of_a_model_is_refused_unread(tmp_path: Path, refused: Refusal) -> None:
    with (tmp_path / "large.onnx").open("wb") as file:
        file.truncate(2**42)  # no memory holds it
    assert "it is larger than 4 MiB" in refused("inspect", tmp_path / "large.onnx")
    os.mkfifo(tmp_path / "pipe.onnx")
    for path in (tmp_path / "pipe.onnx", Path("/dev/zero")):
        assert "it is not a regular file" in refused("inspect", path)
    assert "Is a directory" in refused("inspect", tmp_path)
    assert "No such file" in refused("inspect", tmp_path / "absent.onnx")


def test_wrong_golden_answers_are_refused(
    tmp_path: Path, bench_model: Path, bench: ModelFile, refused: Refusal
) -> None:
    golden = bench.metadata.golden.model_dump()
    golden["answers"]["position_mm"][3] += 0.6
    path = rewritten(bench_model, tmp_path / "changed.onnx", "golden", json.dumps(golden))
    assert "golden answers for position_mm are not reproduced" in refused("inspect", path)


def rewritten(source: Path, target: Path, key: str, value: str | None) -> Path:
    """A copy of a model file with one metadata entry changed or taken out."""
    model = onnx.load(source)
    (entry,) = (one for one in model.metadata_props if one.key == f"beamtouch.{key}")
    if value is None:
        model.metadata_props.remove(entry)
    else:
        entry.value = value
    onnx.save(model, target)
    return target


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        ("schema_version", "6", "schema_version: '6', but this version reads 5; rebuild it from its own scene with"),
        ("noise", None, "noise: Field required"),
        ("noise", "{", "its metadata is not JSON"),
        ("seed", "[" * 100_000, "its metadata is not JSON"),
        ("seed", "9" * 5000, "its metadata is not JSON"),
        ("noise", '{"reading_mm": 1e999, "sample_mm": 1}', "noise.reading_mm: must be a finite number"),
        ("noise", '{"reading_mm": 1, "sample_mm": -1e-9}', "noise.sample_mm: must be at least 0"),
        ("noise", '{"reading_mm": "1", "sample_mm": true}', "noise.reading_mm: must be a number"),
        ("length_mm", '"long"', "length_mm: "),
        ("length_mm", "1e999", "length_mm: must be a finite number"),
        ("max_deflection_mm", "1e999", "max_deflection_mm: must be a finite number"),
        ("axes", "[]", "axes: must have at least 1 "),
        ("axes", '["x", "y", "x"]', "axes: must have at most 2 "),
        ("layout", "[]", "layout: "),
        ("layout", json.dumps([{"name": "s1", "position_mm": 9}] * 4), "two channels have the same name"),
        ("min_channels", "9", "min_channels: 9 of 4 channels"),
        # Lists with an entry per channel, or per position.
        ("floor", '{"gain": [0.1], "zero_mm": [0]}', "thresholds and floor: each list must have 4 entries"),
        ("touch", [17, 17, 17], "thresholds and floor: each list must have 4 entries"),
        ("calibration", json.dumps(CALIBRATION), "calibration.departures: each list must have 4 entries"),
        ("influence", json.dumps({"mm_per_n": [[1, 1, 1]] * 4}), "influence: each list must have 4 entries"),
        ("golden", json.dumps(GOLDEN), "golden: each list must have 4 entries"),
        ("placed", json.dumps(PLACED), "placed: each list must have 4 entries"),
        ("smallest_force", '{"position_mm": [1, 2], "force_n": [2]}', "2 positions with 1 forces"),
        # Thresholds with which everything, or nothing, would be noticed.
        ("touch", [-5, -5, -5, -5], "thresholds.touch.0: must be at least 0"),
        ("rest", [50, 50, 50, 1e9], "thresholds.rest.3: must be at most 1000000"),
        ("misfit", [25, 25, 25, 1e9], "thresholds.misfit.3: must be at most 1000000"),
        ("misfit", [None, None, 25, 25], "thresholds.misfit.0: must be a number"),
    ],
)
def test_metadata_that_is_wrong_is_named(
    tmp_path: Path,
    bench_model: Path,
    bench: ModelFile,
    refused: Refusal,
    key: str,
    value: str | list[float | None] | None,
    said: str,
) -> None:
    if isinstance(value, list):  # one kind of thresholds
        key, value = "thresholds", json.dumps(bench.metadata.thresholds.model_dump() | {key: value})
    assert said in refused("inspect", rewritten(bench_model, tmp_path / "changed.onnx", key, value))


def rename(graph: onnx.GraphProto, old: str, new: str) -> None:
    """Give a tensor of a graph another name, in all its nodes."""
    for node in graph.node:
        node.input[:] = [new if name == old else name for name in node.input]
        node.output[:] = [new if name == old else name for name in node.output]


@pytest.mark.parametrize("where", ["initializer", "constant"])
@pytest.mark.parametrize("location", ["../{folder}/weights.bin", "/dev/zero"])
def test_weights_in_another_file_are_refused(
    bench_model: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, refused: Refusal, location: str, where: str
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "weights.bin").write_bytes(bytes(4096))
    tensor = onnx.TensorProto(name="burden", data_type=onnx.TensorProto.FLOAT, dims=[1])
    tensor.data_location = onnx.TensorProto.EXTERNAL
    for key, value in (("location", location.format(folder=tmp_path.name)), ("offset", "0"), ("length", "4")):
        tensor.external_data.add(key=key, value=value)
    model = onnx.load(bench_model)
    rename(model.graph, "position_mm", "unburdened")
    model.graph.node.append(helper.make_node("Add", ["unburdened", "burden"], ["position_mm"]))
    if where == "initializer":
        model.graph.initializer.append(tensor)
    else:
        model.graph.node.insert(0, helper.make_node("Constant", [], ["burden"], value=tensor))
    (tmp_path / "model.onnx").write_bytes(model.SerializeToString())
    said = refused("inspect", tmp_path / "model.onnx")
    assert "its weights are in another file" in said


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("deflection_mm", "deflections_mm", "inputs deflections_mm, whitening_per_mm; expected deflection_mm, "),
        ("position_mm", "place_mm", "output position_mm is missing"),
    ],
)
def test_a_graph_with_other_inputs_or_outputs_is_refused(
    bench_model: Path, tmp_path: Path, refused: Refusal, old: str, new: str, said: str
) -> None:
    model, path = onnx.load(bench_model), tmp_path / "renamed.onnx"
    for value in (*model.graph.input, *model.graph.output):
        value.name = new if value.name == old else value.name
    rename(model.graph, old, new)
    onnx.save(model, path)
    assert said in refused("inspect", path)


def test_a_model_in_use_reports_to_nobody(bench_model: Path, tmp_path: Path) -> None:
    code = "import sys, pathlib; from beamtouch_models import runtime; runtime.load(pathlib.Path(sys.argv[1]))"
    # In an environment of its own, as the runtime is silent by itself where it finds signs of a test run.
    environment = {name: os.environ[name] for name in ("PATH", "PYTHONPATH") if name in os.environ}
    subprocess.run(
        [sys.executable, "-c", code, bench_model], env={**environment, "HOME": str(tmp_path)}, check=True, timeout=60
    )
    assert not any(tmp_path.iterdir()), "onnxruntime keeps an identifier for its reports in the home folder"


@pytest.mark.parametrize("noise_mm", [None, 0.0, [0.02, 0.03, 0.05, 0.01]])
def test_a_model_answers_with_its_own_noise_and_floor(bench: ModelFile, noise_mm: list[float] | float | None) -> None:
    metadata = bench.metadata
    deflection_mm = np.array([[0.3, 0.7, 0.6, 0.2], [0.2, np.nan, 0.5, 0.3]])
    own = metadata.noise.sample_mm if noise_mm is None or noise_mm == 0.0 else np.array(noise_mm)
    found = bench.answer(deflection_mm, noise_mm)
    for row, seen_mm in enumerate(deflection_mm):
        there = ~np.isnan(seen_mm)
        gain, zero_mm = np.array(metadata.floor.gain), np.array(metadata.floor.zero_mm)
        variance = np.broadcast_to(own, 4) ** 2 + (gain * np.nan_to_num(seen_mm)) ** 2 + zero_mm**2
        whitening = np.diag(there / np.sqrt(variance))
        expected = bench.run(np.nan_to_num(seen_mm)[None], whitening[None])
        assert found.keys() == expected.keys()
        for name, values in expected.items():
            assert values.dtype == np.float32
            assert found[name].dtype == np.float64
            assert found[name][row] == pytest.approx(values[0], rel=1e-4, abs=1e-4)
            assert math.isfinite(values[0])
