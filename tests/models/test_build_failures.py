"""`build` where something inside it goes wrong: nothing is written; and what one failed sensor costs."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
from onnx import numpy_helper

from beamtouch_models.design.building import measure
from beamtouch_models.design.building.remarks import weak_spot
from beamtouch_models.design.building.report import facts
from beamtouch_models.design.estimators import estimator
from beamtouch_models.design.estimators.posterior.window import posterior_graph
from beamtouch_models.design.scene import parse_scene, read_scene
from beamtouch_models.runtime import ModelFile
from support.programs.in_process import Command
from support.surfaces.example_scenes import PAPER, SCENES
from support.surfaces.small_model import PLATE_OUTPUTS, model_of


@pytest.mark.promise(
    "docs/how-to/design.md",
    "`build` warns if one failed sensor ends the surface or doubles the error.",
)
@pytest.mark.parametrize(
    ("sensors", "fewest", "failed_percent", "said"),
    [
        (1, 1, 0, "one failed sensor ends this surface: it has no other; add a sensor"),
        (2, 2, 0, "one failed sensor ends this surface: all 2 channels must work; add a sensor, or place them with --"),
        (2, 2, 100, "one failed sensor ends this surface: all 2 channels must work; add a sensor"),
        (4, 2, 0, "if s1 fails, the mean position error grows from 4 to 12 mm; add a sensor, or place th"),
        (4, 2, 100, "if s1 fails, the mean position error grows from 4 to 12 mm; add a sensor"),
    ],
)
def test_what_one_failed_sensor_costs_is_said(
    bench: ModelFile, sensors: int, fewest: int, failed_percent: float, said: str
) -> None:
    metadata, without = bench.metadata, [3.0, 1.1, 1.1, 1.1][:sensors]
    some = {
        "layout": metadata.layout[:sensors],
        "min_channels": fewest,
        "placed": metadata.placed.model_copy(
            update={"failed_percent": failed_percent, "limit_without_percent": without}
        ),
        "accuracy": metadata.accuracy.model_copy(update={"limit_percent": 1.0}),
    }
    weak = weak_spot(metadata.model_copy(update=some), parse_scene(metadata.scene, "the scene"))
    assert weak.startswith(said)
    assert ("--failed-percent" in weak) is ("--" in said or said.endswith("th"))


def test_what_a_failed_sensor_of_a_plate_costs_is_a_part_of_the_diagonal() -> None:
    metadata = model_of(outputs=PLATE_OUTPUTS, channels=4).metadata
    some = {
        "length_mm": 400.0,
        "width_mm": 300.0,
        "min_channels": 3,
        "placed": metadata.placed.model_copy(update={"limit_without_percent": [3.0, 1.1, 1.1, 1.1]}),
        "accuracy": metadata.accuracy.model_copy(update={"limit_percent": 1.0}),
    }
    weak = weak_spot(metadata.model_copy(update=some), read_scene(SCENES / "plate-on-springs.toml"))
    assert "the mean position error grows from 5 to 15 mm" in weak


@pytest.mark.promise("docs/how-to/drift.md", "`build` warns if that is less than a minute.")
def test_a_drift_that_a_tare_does_not_outlast_is_said(design_sensors_roughly: Command, tmp_path: Path) -> None:
    scene, model = tmp_path / "scene.toml", tmp_path / "model.onnx"
    text = PAPER.replace("count = 2", "count = 2\ngrid_mm = 57")
    for um_per_min, is_short in ((1000, False), (9000, True)):
        scene.write_text(f"{text}\n[environment]\ndrift_um_per_min = {um_per_min}\n")
        built = design_sensors_roughly("build", scene, "-o", model)
        assert built.returncode == 0, built.stderr
        told = re.findall(
            r"zeros that drift by 9000 um a minute .* for (\S+) s after a tare only, over (\S+) um", built.noted
        )
        assert bool(told) is is_short
    ((lasts_s, most_um),) = told
    assert float(lasts_s) == pytest.approx(float(most_um) / 9000 * 60, rel=0.1)


def test_a_model_that_misses_its_bounds_is_not_written_by_build_and_is_a_note_of_trade(
    design_sensors_roughly: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(measure, "MAX_RATIO", 0.1)  # no model is better than the limit
    scene, model = tmp_path / "scene.toml", tmp_path / "model.onnx"
    scene.write_text(PAPER.replace("count = 2", "count = [2, 2]\ngrid_mm = 57"))
    why = "with 0.0228 mm of noise the error is "
    built = design_sensors_roughly("build", scene, "-o", model)
    assert (built.returncode, built.stdout) == (1, "")
    assert f"design-sensors: nothing was written: {why}" in built.stderr
    assert not model.exists()
    traded = design_sensors_roughly("trade", scene, "-o", tmp_path / "out", "--draws", 100, "--estimators", "posterior")
    assert why in traded.stderr
    assert "nothing was written" not in traded.stderr
    assert built.stderr.endswith("95 % intervals; state a larger noise\n")


def test_a_model_with_answers_that_are_not_finite_is_not_written(
    design_sensors_roughly: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def worn_out(*given: Any, **options: Any) -> onnx.ModelProto:  # noqa: ANN401
        graph = posterior_graph(*given, **options)
        largest = max(graph.graph.initializer, key=lambda one: len(one.raw_data))
        values = np.full_like(numpy_helper.to_array(largest), np.nan)
        largest.CopyFrom(numpy_helper.from_array(values, largest.name))
        return graph

    monkeypatch.setattr(estimator, "posterior_graph", worn_out)
    scene, model = tmp_path / "scene.toml", tmp_path / "model.onnx"
    scene.write_text(PAPER.replace("count = 2", "count = 2\ngrid_mm = 57"))
    built = design_sensors_roughly("build", scene, "-o", model)
    assert (built.returncode, built.stdout) == (1, "")
    assert "design-sensors: nothing was written: some answers of the model are not finite; check the s" in built.stderr
    assert not model.exists()


def test_a_build_that_is_interrupted_while_it_measures_for_the_report_leaves_nothing(
    design_sensors_roughly: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(facts, "gather", interrupt)
    scene = tmp_path / "scene.toml"
    scene.write_text(PAPER.replace("count = 2", "count = 2\ngrid_mm = 57"))
    files = ("-o", tmp_path / "m.onnx", "--daemon-config", tmp_path / "d.toml", "--report", tmp_path / "r.html")
    done = design_sensors_roughly("build", scene, *files)
    assert (done.returncode, done.stdout) == (130, "")
    assert list(tmp_path.iterdir()) == [scene]
