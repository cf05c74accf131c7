"""The loader takes a whole, honest model file and nothing else."""

import json
import os
import subprocess
import sys
from pathlib import Path

import onnx
import pytest
from onnx import helper

from beamtouch_models import modelfile
from beamtouch_models.metadata import FORCE_OUTPUTS, POSITION_OUTPUTS
from beamtouch_models.modelfile import ModelFile, ModelFileError

"""A beam on a foundation."""


CALIBRATION = {
    "departures": {"position_offset_mm": [0] * 4, "gain": [1] * 4, "offset_mm": [0] * 3},
    "fitted": [],
    "loads": 10,
    "residual_mm": 0,
    "error_before_mm": 1,
    "error_after_mm": 1,
}
"""Of a model with four channels, and of three of them the offsets."""


def rewritten(source: Path, target: Path, key: str, value: str | None) -> Path:
    """A copy of a model file with one metadata entry changed or taken out."""
    model = onnx.load(source)
    for index, entry in enumerate(model.metadata_props):
        if entry.key == key:
            if value is None:
                del model.metadata_props[index]
            else:
                entry.value = value
            break
    onnx.save(model, target)
    return target


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


@pytest.mark.parametrize("kept", [0, 1, 100, 0.5, 0.99])
def test_a_file_that_is_cut_off_is_refused(bench_model: Path, tmp_path: Path, kept: float) -> None:
    content = bench_model.read_bytes()
    cut = tmp_path / "cut.onnx"
    cut.write_bytes(content[: kept if isinstance(kept, int) else int(len(content) * kept)])
    with pytest.raises(ModelFileError, match=r"cut\.onnx: ") as caught:
        modelfile.load(cut)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("named", [b"beamtouch.length_mm", b"MatMul"])
def test_a_file_with_a_byte_that_is_no_text_is_refused(
    bench_model: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], named: bytes
) -> None:
    content = bench_model.read_bytes()
    damaged = tmp_path / "damaged.onnx"
    damaged.write_bytes(content.replace(named, b"\xff" + named[1:]))
    with pytest.raises(ModelFileError, match=r"damaged\.onnx: damaged or not an ONNX file") as caught:
        modelfile.load(damaged)
    assert "\n" not in str(caught.value)
    assert capsys.readouterr() == ("", "")


def test_other_files_are_refused(tmp_path: Path, bench_model: Path) -> None:
    with pytest.raises(ModelFileError, match="No such file"):
        modelfile.load(str(tmp_path / "absent.onnx"))
    (tmp_path / "text.onnx").write_text("not a model")
    with pytest.raises(ModelFileError, match="damaged or not an ONNX file"):
        modelfile.load(tmp_path / "text.onnx")
    plain = onnx.load(bench_model)
    del plain.metadata_props[:]
    onnx.save(plain, tmp_path / "plain.onnx")
    with pytest.raises(ModelFileError, match="not a Beamtouch model"):
        modelfile.load(tmp_path / "plain.onnx")


def test_wrong_golden_answers_are_refused(tmp_path: Path, bench_model: Path, bench: ModelFile) -> None:
    golden = bench.metadata.golden.model_dump()
    golden["answers"]["position_mm"][3] += 0.6
    changed = rewritten(bench_model, tmp_path / "changed.onnx", "beamtouch.golden", json.dumps(golden))
    with pytest.raises(ModelFileError, match="golden answers for position_mm are not reproduced"):
        modelfile.load(changed)


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        ("beamtouch.schema_version", "5", r"beamtouch\.schema_version: '5', but this version reads 4; rebuild"),
        ("beamtouch.schema_version", "1", r"rebuild it .* with `design-sensors build .*changed\.onnx -o"),
        ("beamtouch.floor", '{"gain": [0.1], "zero_mm": [0]}', "thresholds and floor: each list must have 4 entries"),
        ("beamtouch.noise", '{"reading_mm": "1", "sample_mm": true}', r"noise\.reading_mm: must be a number"),
        ("beamtouch.calibration", json.dumps(CALIBRATION), r"calibration\.departures: each list must have 4 entries"),
        ("beamtouch.layout", "[]", "beamtouch.layout"),
        ("beamtouch.layout", json.dumps([{"name": "s1", "position_mm": 9}] * 4), "two channels have the same name"),
        ("beamtouch.min_channels", "9", "min_channels: 9 of 4 channels"),
        (
            "beamtouch.golden",
            '{"deflection_mm": [[0, 0]], "whitening_per_mm": [[[0, 0], [0, 0]]], "answers": {}}',
            "golden: each list must have 4 entries",
        ),
        ("beamtouch.noise", None, "beamtouch.noise: Field required"),
        ("beamtouch.smallest_force", '{"position_mm": [1, 2], "force_n": [2]}', "2 positions with 1 forces"),
        (
            "beamtouch.placed",
            '{"criterion": "position-error", "spare": 0, "limit_without_percent": [1, 1, 1, 1], '
            '"limit_without_standard_error": []}',
            "placed: each list must have 4 entries",
        ),
        ("misfit", [25, 25, 25, 1e9], r"thresholds\.misfit\.3: must be at most 1000000"),
        ("beamtouch.noise", "{", "not JSON"),
        ("beamtouch.length_mm", '"long"', "beamtouch.length_mm"),
        ("beamtouch.seed", "[" * 100_000, "its metadata is not JSON"),
        ("beamtouch.seed", "9" * 5000, "its metadata is not JSON"),
        ("touch", [-5, -5, -5, -5], r"thresholds\.touch\.0: .* at least 0"),
        ("misfit", [None, None, 25, 25], r"thresholds\.misfit\.0: must be a number"),
        ("touch", [17, 17, 17], "thresholds and floor: each list must have 4 entries"),
        (
            "beamtouch.influence",
            json.dumps({"mm_per_n": [[1, 1, 1]] * 4}),
            "influence: each list must have 4 entries",
        ),
    ],
)
def test_metadata_that_is_wrong_is_named(
    tmp_path: Path,
    bench_model: Path,
    bench: ModelFile,
    key: str,
    value: str | float | list[float | None] | None,
    said: str,
) -> None:
    if isinstance(value, list | float):  # one kind of thresholds
        key, value = "beamtouch.thresholds", json.dumps(bench.metadata.thresholds.model_dump() | {key: value})
    with pytest.raises(ModelFileError, match=said):
        modelfile.load(rewritten(bench_model, tmp_path / "changed.onnx", key, value))


def with_burden(source: Path, target: Path) -> Path:
    """A copy of a model whose position waits for a tensor `burden`, which it does not have yet."""
    model = onnx.load(source)
    for node in model.graph.node:
        node.output[:] = ["unburdened" if name == "position_mm" else name for name in node.output]
        node.input[:] = ["unburdened" if name == "position_mm" else name for name in node.input]
    model.graph.node.append(helper.make_node("Add", ["unburdened", "burden"], ["position_mm"]))
    onnx.save(model, target)
    return target


def test_a_file_that_is_too_large_is_refused_unread(tmp_path: Path) -> None:
    with (tmp_path / "large.onnx").open("wb") as file:
        file.truncate(2**42)  # no memory holds it
    with pytest.raises(ModelFileError, match=r"large\.onnx: it is larger than 4 MiB"):
        modelfile.load(tmp_path / "large.onnx")


def test_a_path_that_is_not_a_regular_file_is_refused(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.onnx")
    for path, said in (
        (tmp_path / "pipe.onnx", "it is not a regular file"),
        (Path("/dev/zero"), "it is not a regular file"),
        (tmp_path, "Is a directory"),
    ):
        with pytest.raises(ModelFileError, match=said):
            modelfile.load(path)


@pytest.mark.parametrize("where", ["initializer", "constant"])
@pytest.mark.parametrize("location", ["../{folder}/weights.bin", "/dev/zero"])
def test_weights_in_another_file_are_refused(
    bench_model: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, location: str, where: str
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "weights.bin").write_bytes(bytes(4096))
    tensor = onnx.TensorProto(name="burden", data_type=onnx.TensorProto.FLOAT, dims=[1])
    tensor.data_location = onnx.TensorProto.EXTERNAL
    named = location.format(folder=tmp_path.name, path=tmp_path)
    for key, value in (("location", named), ("offset", "0"), ("length", "4")):
        tensor.external_data.add(key=key, value=value)
    path = with_burden(bench_model, tmp_path / "model.onnx")
    model = onnx.load(path)
    if where == "initializer":
        model.graph.initializer.append(tensor)
    else:
        model.graph.node.insert(0, helper.make_node("Constant", [], ["burden"], value=tensor))
    path.write_bytes(model.SerializeToString())
    with pytest.raises(ModelFileError, match=r"its weights are in another file|damaged") as caught:
        modelfile.load(path)
    if where == "initializer":
        assert "its weights are in another file" in str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("deflection_mm", "deflections_mm", "inputs deflections_mm, whitening_per_mm; expected deflection_mm, "),
        ("position_mm", "place_mm", "output position_mm is missing"),
    ],
)
def test_a_graph_with_other_inputs_or_outputs_is_refused(
    bench_model: Path, tmp_path: Path, old: str, new: str, said: str
) -> None:
    model, path = onnx.load(bench_model), tmp_path / "renamed.onnx"
    for value in (*model.graph.input, *model.graph.output):
        value.name = new if value.name == old else value.name
    for node in model.graph.node:
        node.input[:] = [new if name == old else name for name in node.input]
        node.output[:] = [new if name == old else name for name in node.output]
    onnx.save(model, path)
    with pytest.raises(ModelFileError, match=said):
        modelfile.load(path)


def test_a_model_in_use_reports_to_nobody(bench_model: Path, tmp_path: Path) -> None:
    code = "import sys, pathlib; from beamtouch_models import modelfile; modelfile.load(pathlib.Path(sys.argv[1]))"
    # In an environment of its own, as the runtime is silent by itself where it finds signs of a test run.
    environment = {name: os.environ[name] for name in ("PATH", "PYTHONPATH") if name in os.environ}
    subprocess.run(
        [sys.executable, "-c", code, bench_model], env={**environment, "HOME": str(tmp_path)}, check=True, timeout=60
    )
    assert not any(tmp_path.iterdir()), "onnxruntime keeps an identifier for its reports in the home folder"
