"""What `design-sensors build` reads, and what it says beside the model, where the building itself is known."""

import json
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import onnx
import pytest

from beamtouch_models.design.building.build import build_model
from beamtouch_models.design.layout import Layout, keep_sensors
from beamtouch_models.design.placement.placing import DEFAULT_AIM, Aim
from beamtouch_models.design.scene import parse_scene
from beamtouch_models.design.surface import Surface, resolve
from beamtouch_models.errors import SceneError
from beamtouch_models.places import Place
from beamtouch_models.runtime import ModelFile
from support.programs.in_process import Command
from support.surfaces.example_scenes import PAPER

POSITIONS_MM = (60.0, 150.0, 250.0, 340.0)


@pytest.fixture
def asked(bench: ModelFile, bench_model: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """What a build asks for; the model that it makes is that of the bench, and nothing is written."""
    asked = dict[str, Any]()

    def place(surface: Surface, *, count: int | None, seed: int, aim: Aim, progress: object) -> Layout:  # noqa: ARG001
        asked.update(placed=count, seed=seed, aim=aim)
        return keep_sensors(surface, POSITIONS_MM, aim)

    def keep(surface: Surface, positions_mm: Sequence[Place], aim: Aim) -> Layout:
        asked.update(kept=list(positions_mm), aim=aim)
        return keep_sensors(surface, positions_mm, aim)

    def build(_layout: Layout, name: str, **how: object) -> SimpleNamespace:
        asked.update(how, name=name)
        return SimpleNamespace(content=bench_model.read_bytes(), metadata=bench.metadata)

    for name, stand_in in (
        ("place_sensors", place), ("keep_sensors", keep), ("build_model", build),
        ("write_products", lambda *_, **__: None), ("describe_table_cost", lambda *_: ""),
    ):  # fmt: skip
        monkeypatch.setattr(f"beamtouch_models.commands.build.{name}", stand_in)
    return asked


SCENE = PAPER.replace("count = 2\nnoise_percent_of_max = 2", "count = 4\nnoise_mm = 0.0012345")


@pytest.mark.parametrize(
    ("changes", "assumed"),
    [
        (
            (),
            "contact.force_tolerance_percent = 1, sensors.gain_error_percent = 0.3, sensors.zero_drift_mm = 0.00025, "
            "environment.drift_um_per_min = 5",
        ),
        (
            (("force_n = 10.0", "force_n = [2, 20]"), ("[sensors]", "[sensors]\nzero_drift_mm = 0.003")),
            "sensors.gain_error_percent = 0.3, environment.drift_um_per_min = 1.23",
        ),
        (
            (
                ("force_n = 10.0", "force_n = 10.0\nforce_tolerance_percent = 0"),
                ("[sensors]", "[environment]\ndrift_um_per_min = 2\n[sensors]\ngain_error_percent = 0.5"),
            ),
            "sensors.zero_drift_mm = 0.00025",
        ),
    ],
)
def test_errors_that_no_scene_states_are_told_as_they_are_assumed(
    design_sensors_here: Command,
    asked: dict[str, Any],
    tmp_path: Path,
    changes: Sequence[tuple[str, str]],
    assumed: str,
) -> None:
    text = SCENE
    for old, new in changes:
        text = text.replace(old, new)
    scene = tmp_path / "press 7.toml"
    scene.write_text(text)
    done = design_sensors_here("build", scene, "-o", tmp_path / "new.onnx", "--seed", 6)
    assert done.returncode == 0, done.stderr
    assert f"note: not stated in the scene, so assumed: {assumed} " in f"{done.noted} "
    assert (asked["name"], asked["text"], asked["seed"], asked["estimator"]) == ("press-7", text, 6, "posterior")


def test_where_a_scene_states_all_errors_none_is_assumed(
    design_sensors_here: Command, asked: dict[str, Any], tmp_path: Path
) -> None:
    scene = tmp_path / "scene.toml"
    stated = "[environment]\ndrift_um_per_min = 2\n[sensors]\ngain_error_percent = 0.5\nzero_drift_mm = 0.001"
    scene.write_text(SCENE.replace("force_n = 10.0", "force_n = [2, 20]").replace("[sensors]", stated))
    done = design_sensors_here("build", scene, "-o", tmp_path / "new.onnx", "--sensors", 4, "--failed-percent", 30)
    assert done.returncode == 0
    assert "assumed" not in done.noted
    assert (asked["placed"], asked["aim"].failed_percent, "kept" in asked) == (4, 30.0, False)


def stored(folder: Path, **entries: object) -> Path:
    """Write what a model file of some version has of its scene and its layout."""
    model = onnx.ModelProto()
    layout = [{"name": f"s{number}", "position_mm": mm} for number, mm in enumerate(POSITIONS_MM, 1)]
    for key, value in ({"layout": layout, "scene": SCENE, "name": "old-one"} | entries).items():
        model.metadata_props.add(key=f"beamtouch.{key}", value=json.dumps(value))
    path = folder / "old.onnx"
    path.write_bytes(model.SerializeToString())
    return path


NEW: dict[str, list[float]] = {"limit_without_percent": [], "limit_without_standard_error": []}
BEFORE: list[tuple[dict[str, Any], tuple[str, float | None]]] = [
    ({}, ("eigenvalue-product", None)),  # of a version that did not state it
    ({"placed": {"criterion": "position-error", "spare": 1, **NEW}}, ("position-error", 100.0)),
    ({"placed": {"criterion": "position-error", "spare": 0, **NEW}}, ("position-error", 0.0)),
    ({"placed": {"criterion": "eigenvalue-product", "spare": 1, **NEW}}, ("eigenvalue-product", None)),
    ({"placed": {"criterion": "position-error", "failed_percent": 12.5, **NEW}}, ("position-error", 12.5)),
]


@pytest.mark.parametrize(("entries", "aim"), BEFORE)
def test_a_model_of_any_version_is_built_anew_for_its_mounted_sensors_and_with_its_aim(
    design_sensors_here: Command,
    asked: dict[str, Any],
    tmp_path: Path,
    entries: dict[str, Any],
    aim: tuple[str, float | None],
) -> None:
    done = design_sensors_here("build", stored(tmp_path, **entries), "-o", tmp_path / "new.onnx", "--effort", 0.5)
    assert done.returncode == 0, done.stderr
    assert (asked["kept"], asked["name"], asked["text"]) == (list(POSITIONS_MM), "old-one", SCENE)
    assert (asked["aim"].criterion, asked["aim"].failed_percent, asked["aim"].effort.share) == (*aim, 0.5)
    assert "placed" not in asked


@pytest.mark.parametrize(
    "options", [("--move-sensors",), ("--sensors", 4), ("--criterion", "position-error"), ("--failed-percent", 10)]
)
def test_sensors_of_a_model_are_placed_anew_where_that_is_asked_for(
    design_sensors_here: Command, asked: dict[str, Any], tmp_path: Path, options: tuple[object, ...]
) -> None:
    done = design_sensors_here("build", stored(tmp_path), "-o", tmp_path / "new.onnx", *options)
    assert done.returncode == 0, done.stderr
    assert ("placed" in asked, "kept" in asked) == (True, False)
    assert asked["aim"].criterion == DEFAULT_AIM.criterion


def test_a_build_goes_from_the_layout_over_the_estimator_to_the_measurements(monkeypatch: pytest.MonkeyPatch) -> None:
    steps = list[tuple[str, float]]()

    def make(_layout: Layout, name: str, seed: int, progress: Callable[[float], None]) -> str:
        for done in (0.0, 0.5, 1.0):
            progress(done)
        return f"{name} of seed {seed}"

    def measure(made: str, *_: object) -> None:
        raise SceneError(f"measured {made}")

    monkeypatch.setattr(Layout, "make_estimator", make)
    monkeypatch.setattr("beamtouch_models.design.building.build.measure", measure)
    layout = keep_sensors(resolve(parse_scene(SCENE, "scene")), POSITIONS_MM)
    with pytest.raises(SceneError, match=r"^measured small-network of seed 7$"):
        build_model(layout, "press-7", estimator="small-network", seed=7, progress=lambda *step: steps.append(step))
    assert [text for text, _ in steps] == ["making the estimator"] * 3 + ["measuring the accuracy against the limit"]
    # The layout before it takes three tenths, and what is measured after it the last fifth.
    assert [share for _, share in steps] == pytest.approx([0.3, 0.55, 0.8, 0.8])


@pytest.mark.parametrize(
    ("name", "estimator", "said"),
    [
        ("two words", "posterior", "name = 'two words' must have 1 to 64 letters"),
        ("press-7", "best", "estimator = 'best' must be one of posterior, "),
        (7, "posterior", "name: give text, not int '7'"),
    ],
)
def test_a_model_has_a_name_and_one_of_the_estimators(name: Any, estimator: Any, said: str) -> None:  # noqa: ANN401
    layout = keep_sensors(resolve(parse_scene(SCENE, "scene")), POSITIONS_MM)
    with pytest.raises(SceneError, match=re.escape(said)):
        build_model(layout, name, estimator=estimator, seed=0)
