"""The loader takes a whole, honest model file and nothing else."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import onnx
import pytest

from beamtouch_models import modelfile
from beamtouch_models.modelfile import ModelFile, ModelFileError


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


def test_a_built_model_loads_and_says_what_it_is(bench: ModelFile) -> None:
    assert bench.metadata.name == "bench"
    assert bench.identity.startswith("bench@")
    assert bench.channels == ["s1", "s2", "s3", "s4"]
    assert [channel.position_mm for channel in bench.metadata.layout] == [68, 156, 244, 332]
    assert bench.outputs == modelfile.POSITION_OUTPUTS + modelfile.FORCE_OUTPUTS
    # 20 N in the middle of 400 mm of 210 GPa steel, 25 x 3 mm.
    assert bench.metadata.max_deflection_mm == pytest.approx(20 * 400**3 / (48 * 1.18125e7), rel=1e-9)
    assert bench.metadata.noise.sample_mm == pytest.approx(0.001 * bench.metadata.max_deflection_mm, rel=1e-9)


def test_a_model_answers_a_batch(bench: ModelFile) -> None:
    answers = bench.estimate(np.zeros((3, 4), np.float32), np.ones((3, 4), np.bool_))
    assert set(answers) == set(bench.outputs)
    assert all(values.shape == (3,) and values.dtype == np.float32 for values in answers.values())


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


def test_other_files_are_refused(tmp_path: Path, bench_model: Path) -> None:
    with pytest.raises(ModelFileError, match="No such file"):
        modelfile.load(tmp_path / "absent.onnx")
    (tmp_path / "text.onnx").write_text("not a model")
    with pytest.raises(ModelFileError, match="damaged or not an ONNX file"):
        modelfile.load(tmp_path / "text.onnx")
    plain = onnx.load(bench_model)
    del plain.metadata_props[:]
    onnx.save(plain, tmp_path / "plain.onnx")
    with pytest.raises(ModelFileError, match="not a Beamtouch model"):
        modelfile.load(tmp_path / "plain.onnx")


def test_other_golden_answers_are_refused(tmp_path: Path, bench_model: Path, bench: ModelFile) -> None:
    golden = bench.metadata.golden.model_dump()
    golden["answers"]["position_mm"][3] += 0.6
    changed = rewritten(bench_model, tmp_path / "changed.onnx", "beamtouch.golden", json.dumps(golden))
    with pytest.raises(ModelFileError, match="golden answers for position_mm do not come out"):
        modelfile.load(changed)


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        ("beamtouch.schema_version", "2", "beamtouch.schema_version"),
        ("beamtouch.layout", "[]", "beamtouch.layout"),
        ("beamtouch.noise", None, "beamtouch.noise: Field required"),
        ("beamtouch.noise", "{", "not JSON"),
        ("beamtouch.length_mm", '"long"', "beamtouch.length_mm"),
    ],
)
def test_metadata_that_is_wrong_is_named(
    tmp_path: Path, bench_model: Path, key: str, value: str | None, said: str
) -> None:
    with pytest.raises(ModelFileError, match=said):
        modelfile.load(rewritten(bench_model, tmp_path / "changed.onnx", key, value))


def test_the_door_is_light() -> None:
    script = "import sys, beamtouch_models.modelfile; print(*sorted({name.split('.')[0] for name in sys.modules}))"
    loaded = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout.split()
    assert "onnxruntime" in loaded
    assert not {"scipy", "onnx", "rich", "fastapi", "pymodbus", "serial"} & set(loaded)
