"""A model file by its bytes and entries: what it is taken for, what is refused, and what it answers."""

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest

from beamtouch_models.errors import ModelFileError
from beamtouch_models.runtime import Metadata, ModelFile, load
from beamtouch_models.runtime.loading import load_bytes
from beamtouch_models.runtime.metadata import fewest_that_check
from beamtouch_models.runtime.session import GraphError, graph_errors
from support.surfaces.small_model import PLATE_OUTPUTS, content_of, model_of

BEAM, PLATE = model_of().metadata, model_of(channels=4, outputs=PLATE_OUTPUTS).metadata


def changed(metadata: Metadata, **parts: object) -> dict[str, str]:
    """Return the entries of a model file with other values of some."""
    return metadata.to_entries() | {f"beamtouch.{name}": json.dumps(value) for name, value in parts.items()}


def refusal(metadata: Metadata, **parts: object) -> str:
    with pytest.raises(ModelFileError) as refused:
        Metadata.from_entries(changed(metadata, **parts))
    return str(refused.value)


def test_a_model_is_read_from_its_own_entries_as_it_was_written() -> None:
    for metadata in (BEAM, PLATE):
        assert Metadata.from_entries(metadata.to_entries() | {"author": "somebody"}) == metadata
    entries = BEAM.to_entries()
    del entries["beamtouch.axes"], entries["beamtouch.calibration"], entries["beamtouch.width_mm"]
    assert Metadata.from_entries(entries) == BEAM


@pytest.mark.parametrize(
    ("metadata", "parts", "said"),
    [
        (BEAM, {"min_channels": 4}, "metadata: min_channels: 4 of 3 channels"),
        (BEAM, {"min_channels": 0}, "metadata entry beamtouch.min_channels: must be at least 1"),
        (BEAM, {"width_mm": 30.0}, "metadata: axes: position, with width_mm = 30.0; only two axes have one"),
        (PLATE, {"width_mm": None}, "metadata: axes: x, y, with width_mm = None; only two axes have one"),
        (PLATE, {"axes": ["x", "x"]}, "metadata: axes: x, x, with width_mm = 300.0; only two axes have one"),
        (
            BEAM,
            {"ranges": {"position_mm": [1, 2], "across_mm": [1, 2], "force_n": [1, 2]}},
            "metadata: across_mm: layout and ranges have it on two axes, and only there",
        ),
        (
            PLATE,
            {"ranges": {"position_mm": [1, 2], "force_n": [1, 2]}},
            "metadata: across_mm: layout and ranges have it on two axes, and only there",
        ),
        (
            PLATE,
            {"layout": [{"name": f"s{place}", "position_mm": 1.0} for place in range(4)]},
            "metadata: across_mm: layout and ranges have it on two axes, and only there",
        ),
        (
            BEAM,
            {"layout": [{"name": f"s{place}", "position_mm": 1.0, "unit": unit} for place, unit in enumerate("VAV")]},
            "metadata: layout: channels with different units, A and V",
        ),
        (
            PLATE,
            {"smallest_force": {"position_mm": [1, 2], "across_mm": [1], "force_n": [1, 2]}},
            "metadata entry beamtouch.smallest_force: 2 positions with 1 across",
        ),
        (
            BEAM,
            {
                "golden": {
                    "deflection_mm": [[0.1, 0.2, 0.3]] * 2,
                    "whitening_per_mm": [[[1.0, 0.0, 0.0]] * 3, [[1.0, 0.0, 0.0]] * 2],
                    "answers": {},
                }
            },
            "metadata: golden: each input must have 3 channels",
        ),
        (
            BEAM,
            {"schema_version": "9" * 30},
            "metadata entry beamtouch.schema_version: '\"9999999999999999999', but this version reads 5; rebuild it "
            "from its own scene with `design-sensors build MODEL.onnx -o MODEL.onnx`, and calibrate it again if it was "
            "calibrated",
        ),
    ],
)
def test_entries_that_do_not_fit_together_are_named(metadata: Metadata, parts: dict[str, Any], said: str) -> None:
    assert refusal(metadata, **parts) == said


def test_a_file_without_entries_of_beamtouch_is_none() -> None:
    with pytest.raises(ModelFileError, match="has no beamtouch metadata"):
        Metadata.from_entries({"author": "somebody", "schema_version": "5"})


def test_departures_have_a_number_for_each_channel() -> None:
    departures = {
        "position_offset_mm": [0.0] * 4,
        "gain": [1.0] * 4,
        "offset_mm": [0.5] * 4,
        "across_offset_mm": [0.0] * 3,
    }
    calibration = {"departures": departures, "fitted": [], "loads": 10, "residual_mm": 0}
    assert "calibration.departures: each list must have 4 entries" in refusal(PLATE, calibration=calibration)
    departures["across_offset_mm"] = [0.25] * 4
    read = Metadata.from_entries(changed(PLATE, calibration=calibration))
    assert read.departures.offset_mm == [0.5] * 4
    assert PLATE.departures.gain == [1.0] * 4


def test_places_are_along_the_axes_of_the_structure() -> None:
    assert BEAM.layout_mm.tolist() == [100.0, 200.0, 300.0]
    assert PLATE.layout_mm.tolist() == [[100.0, 50.0], [200.0, 150.0], [300.0, 250.0], [400.0, 50.0]]
    assert BEAM.place_of(BEAM.layout[1]) == {"position": 200.0}
    assert PLATE.place_of(PLATE.layout[1]) == {"x": 200.0, "y": 150.0}
    assert (BEAM.size_mm, PLATE.size_mm) == ((400.0,), (400.0, 300.0))
    assert (BEAM.diagonal_mm, PLATE.diagonal_mm) == (400.0, 500.0)
    assert BEAM.extent.ranges_mm == ((1.0, 399.0),)
    assert PLATE.extent.ranges_mm == ((1.0, 399.0), (1.0, 299.0))
    assert [fewest_that_check(axes) for axes in (1, 2)] == [3, 4]


def with_entries(entries: dict[str, str], content: bytes | None = None) -> bytes:
    """Return a small model with other entries."""
    model = onnx.load_from_string(content or content_of())
    for entry in model.metadata_props:
        entry.value = entries.get(entry.key, entry.value)
    made: bytes = model.SerializeToString()
    return made


def golden(change: dict[str, list[float]], *, without: str = "") -> bytes:
    """Return a small model with other golden answers, added to its own."""
    stored = BEAM.golden.model_dump()
    for name, more in change.items():
        stored["answers"][name] = [own + one for own, one in zip(stored["answers"][name], more, strict=False)]
    stored["answers"].pop(without, None)
    return with_entries(changed(BEAM, golden=stored))


@pytest.mark.parametrize(
    ("content", "name"),
    [
        # A thousandth of 130 mm and a thousandth more.
        (golden({"position_mm": [0.128, 0.0]}), None),
        (golden({"position_mm": [0.134, 0.0]}), "position_mm"),
        (golden({"position_mm": [0.0, -0.104]}), "position_mm"),
        (golden({"misfit": [0.0009, 0.0]}), None),
        (golden({"misfit": [0.0, 0.0011]}), "misfit"),
        (golden({}, without="force_n"), "force_n"),
        (golden({"misfit": [0.0]}), "misfit"),
    ],
)
def test_golden_answers_are_reproduced_within_a_thousandth(content: bytes, name: str | None) -> None:
    if name is None:
        assert load_bytes(content, "here").metadata.name == "press-7"
        return
    with pytest.raises(ModelFileError) as refused:
        load_bytes(content, "here")
    assert str(refused.value) == f"here: its golden answers for {name} are not reproduced on this machine"


def test_a_refusal_names_the_file_in_the_command_that_mends_it() -> None:
    with pytest.raises(ModelFileError) as refused:
        load_bytes(with_entries({"beamtouch.schema_version": "4"}), "old.onnx")
    assert str(refused.value).startswith("old.onnx: metadata entry beamtouch.schema_version: '4', but this version ")
    assert "`design-sensors build old.onnx -o old.onnx`" in str(refused.value)


def test_a_loaded_model_says_what_it_is() -> None:
    content, model = content_of(), model_of()
    assert model.identity == f"press-7@{hashlib.sha256(content).hexdigest()[:6]}"
    assert model.channels == ["s1", "s2", "s3"]
    assert model.largest_mm == 100.0
    assert model.lacks == []
    assert model_of(outputs=("position_mm", "misfit")).lacks == [
        "position_low_mm", "position_high_mm", "contact_log_odds",
    ]  # fmt: skip


def test_a_file_of_four_mebibytes_is_read_and_a_larger_one_is_not(tmp_path: Path) -> None:
    path = tmp_path / "large.onnx"
    for size, said in (
        (4 * 2**20, "damaged or not an ONNX file"),
        (4 * 2**20 + 1, "larger than 4 MiB, so `design-sen"),
    ):
        path.write_bytes(bytes(size))
        with pytest.raises(ModelFileError, match=said):
            load(path)
    path.write_bytes(content_of())
    assert load(path).identity == model_of().identity
    assert load(str(path)).metadata == BEAM


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("scene.toml", "scene.toml: this is no model; give the .onnx file that `design-sensors build` wrote"),
        ("a\0b", "cannot be the path of a file"),
        ("", "Is a directory"),
        ("none.onnx", "No such file or directory"),
    ],
)
def test_what_is_no_model_is_told(tmp_path: Path, name: str, said: str) -> None:
    (tmp_path / "scene.toml").write_text("")
    with pytest.raises(ModelFileError) as refused:
        load(f"{tmp_path}/{name}")
    assert str(refused.value).endswith(said)


def test_a_graph_answers_in_the_thread_that_asks_and_says_nothing() -> None:
    options = model_of().graph.session.get_session_options()
    assert options.intra_op_num_threads == 1
    assert options.log_severity_level == 4  # fatal errors only
    assert model_of().graph.session.get_providers() == ["CPUExecutionProvider"]


def test_more_samples_than_a_chunk_are_answered_in_their_order() -> None:
    deflection_mm = np.arange(900.0)[:, None] * [0.0, 1e-3, 0.0]
    whitening = np.broadcast_to(np.eye(3), (900, 3, 3))
    answers = model_of().run(deflection_mm, whitening)
    assert answers["position_mm"] == pytest.approx(100 + 0.1 * np.arange(900.0), rel=1e-5)
    assert {
        name: len(values) for name, values in model_of().run(deflection_mm[:0], whitening[:0]).items()
    } == dict.fromkeys(model_of().outputs, 0)


@pytest.mark.parametrize(
    ("error", "said"), [(RuntimeError("first line\nsecond"), "first line"), (MemoryError(), "MemoryError")]
)
def test_an_error_of_a_graph_is_told_in_one_line(error: Exception, said: str) -> None:
    with pytest.raises(GraphError) as raised, graph_errors():
        raise error
    assert str(raised.value) == said


def test_golden_answers_know_a_channel_that_is_missing(bench: ModelFile) -> None:
    weights = np.array(bench.metadata.golden.whitening_per_mm)
    takes_part = (weights != 0).any(axis=1)
    assert takes_part.all(axis=1).sum() == len(weights) - 1
    assert takes_part[~takes_part.all(axis=1)].tolist() == [[False, True, True, True]]
