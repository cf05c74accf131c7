"""Files that a calibration and a model are made from, damaged or of another version: refused in one line."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest

from beamtouch_models.accuracy.limit import accuracy_limit
from beamtouch_models.accuracy.prior import Prior
from beamtouch_models.building.measure import reach
from beamtouch_models.calibration.contacts import MAX_BYTES
from beamtouch_models.calibration.rebuilt import remade
from beamtouch_models.errors import NotGoodEnoughError
from beamtouch_models.estimators.estimator import ENOUGH, MAX_SETS, Estimator, estimator_of, fewest_channels
from beamtouch_models.estimators.onnx_graph import to_bytes
from beamtouch_models.loading import load, load_bytes
from beamtouch_models.metadata import Calibration, Departures
from beamtouch_models.modelfile import ModelFile, ModelFileError
from beamtouch_models.physics.beam import influence_of
from beamtouch_models.session import runner
from beamtouch_models.surface import prior_of_model
from beamtouch_models.sweeps import silent
from example_scenes import paper_scene
from in_process import Command
from posterior_cases import graph_of, prior_of


@pytest.mark.parametrize(
    ("content", "said"),
    [(None, "No such file or directory"), (b"\xff\xfe\x00load", "not a CSV file"), (b"", "no samples; record loads")],
)
def test_a_recording_that_cannot_be_read_is_refused(
    design_sensors_here: Command, bench_model: Path, tmp_path: Path, content: bytes | None, said: str
) -> None:
    path, output = tmp_path / "loads.csv", tmp_path / "out.onnx"
    if content is not None:
        path.write_bytes(content)
    done = design_sensors_here("calibrate", bench_model, path, "-o", output)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert f"{path}: {said}" in done.stderr
    assert not output.exists()


def test_contacts_that_no_memory_should_hold_are_refused(
    design_sensors_here: Command, bench_model: Path, tmp_path: Path
) -> None:
    path, output = tmp_path / "contacts.csv", tmp_path / "out.onnx"
    with path.open("wb") as file:
        file.truncate(MAX_BYTES + 1)  # a hole, which takes no room on the disk
    done = design_sensors_here("calibrate", bench_model, "--events", path, "-o", output)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert "larger than 64 MiB; fetch fewer contacts, with ?limit=" in done.stderr


def without_a_channel(metadata: dict[str, Any]) -> None:
    for row in metadata["influence"]["mm_per_n"]:
        row.pop()


def test_a_model_whose_figures_contradict_each_other_is_refused(bench_model: Path, tmp_path: Path) -> None:
    model, path = onnx.load(bench_model), tmp_path / "changed.onnx"
    entries = {entry.key.rpartition(".")[2]: entry for entry in model.metadata_props}
    metadata = {key: json.loads(entry.value) for key, entry in entries.items()}
    without_a_channel(metadata)
    for key, value in metadata.items():
        entries[key].value = json.dumps(value)
    onnx.save(model, path)
    with pytest.raises(ModelFileError, match="influence: each list must have 4 entries"):
        load(path)


def test_a_model_of_an_estimator_that_is_no_more_is_not_calibrated(bench: ModelFile) -> None:
    later = bench.metadata.model_copy(update={"estimator": "oracle"})
    prior, least_mm = prior_of_model(later), later.filter.min_noise_mm(later.noise)
    made = estimator_of("posterior", prior, min_noise_mm=least_mm, with_force=True, seed=later.seed, progress=silent)
    content = to_bytes(made.graph, later)
    metadata = load_bytes(content, "later.onnx").metadata
    calibration = Calibration(
        departures=Departures(position_offset_mm=[0.0] * 4, gain=[1.0] * 4, offset_mm=[0.0] * 4),
        fitted=[],
        loads=10,
        residual_mm=0.0,
        error_before_mm=1.0,
        error_after_mm=1.0,
    )
    with pytest.raises(ModelFileError, match="this version has no estimator 'oracle'; build the model again"):
        remade(metadata, prior_of_model(metadata), calibration)


def test_a_model_whose_answers_are_no_numbers_is_not_written() -> None:
    prior = prior_of("bench", 3, 2.0, known=False)
    graph = graph_of(prior)
    for tensor in graph.graph.initializer:
        if tensor.data_type == onnx.TensorProto.FLOAT:
            values = np.full_like(onnx.numpy_helper.to_array(tensor), np.nan)
            tensor.CopyFrom(onnx.numpy_helper.from_array(values, tensor.name))
    with pytest.raises(NotGoodEnoughError, match="some answers of the model are not finite"):
        reach(Estimator("posterior", graph, 2), prior, runner(to_bytes(graph)), 1000, 0)


def test_of_many_sensors_neighbours_show_how_many_are_enough() -> None:
    influence, sensor_mm = influence_of(paper_scene()), np.linspace(40.0, 360.0, 9)
    prior = Prior.of(influence, sensor_mm, 0.05)
    found = fewest_channels(prior, 0)
    assert 3 <= found < 9  # of three among nine there are 84 sets, more than are all evaluated
    assert MAX_SETS < 84

    def share(kept: range) -> float:
        """The error of neighbours over that of a guess, a quarter of the range."""
        some = prior.without(*(set(range(9)) - set(kept)))
        return accuracy_limit(some, 512, 0).percent / ((399 - 1) / 4 / 400 * 100)

    assert max(share(range(first, first + found)) for first in range(9 - found + 1)) <= ENOUGH
    assert max(share(range(first, first + found - 1)) for first in range(9 - found + 2)) > ENOUGH
