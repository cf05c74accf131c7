"""The interface for scripts gives what the commands give, and refuses with one line."""

import json
import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import beamtouch_models as models
from beamtouch_common.errors import InputError
from beamtouch_models import cli
from beamtouch_models.errors import SceneError
from beamtouch_models.runtime import Calibration, ModelFile
from support.surfaces.example_scenes import ROUGH, SCENES

SCENE = (SCENES / "bench.toml").read_text()


@pytest.fixture
def scene() -> models.Scene:
    return models.read_scene(SCENES / "bench.toml")


def test_everything_public_has_a_docstring() -> None:
    assert all(getattr(models, name).__doc__ for name in models.__all__)


def test_a_scene_is_read_from_a_file_and_from_text(scene: models.Scene) -> None:
    assert models.read_scene(SCENE) == models.read_scene(str(SCENES / "bench.toml")) == scene
    with pytest.raises(InputError, match="beem"):
        models.read_scene("[beem]\nlength_mm = 400")


def test_the_layout_of_least_error_is_no_worse_than_that_of_the_paper(scene: models.Scene) -> None:
    scene = models.change_scene(scene, sensors={"grid_mm": 8})
    layouts = [models.place(scene, 2, criterion=name) for name in ("position-error", "eigenvalue-product")]
    best, papers = (models.accuracy_limit(scene, layout, draws=2000) for layout in layouts)

    assert best.mean_mm < papers.mean_mm
    assert best.percent == pytest.approx(best.mean_mm / 4)
    assert 0 < best.standard_error_mm < 0.1 * best.mean_mm


def test_the_error_along_the_beam_has_the_mean_of_the_limit(scene: models.Scene) -> None:
    layout, place = [68, 156, 244, 332], 1 + 398 * (np.arange(80) + 0.5) / 80
    limit = models.accuracy_limit(scene, layout, draws=4000)

    along = models.error_along_mm(scene, layout, place, draws=50)

    assert along.shape == (80,)
    assert along.mean() == pytest.approx(limit.mean_mm, rel=0.1)
    assert along[0] > along[40]


def test_a_model_locates_the_load_that_bent_the_beam(scene: models.Scene, bench_model: Path) -> None:
    model = models.load_model(bench_model)
    sensors = [channel.position_mm for channel in model.metadata.layout]

    found = models.estimate(model, 10 * models.influence_matrix(scene, sensors, [100, 250]))

    assert found["position_mm"] == pytest.approx([100, 250], abs=2)
    assert found["force_n"] == pytest.approx([10, 10], rel=0.02)
    assert np.all(found["position_low_mm"] < found["position_high_mm"])
    assert {name: values.shape for name, values in models.estimate(model, np.empty((0, 4))).items()} == dict.fromkeys(
        found, (0,)
    )
    others = (str(bench_model), bench_model.read_bytes())
    assert {models.load_model(one).identity for one in others} == {model.identity}


def test_a_touched_beam_rings_around_its_deflection(scene: models.Scene) -> None:
    mass_per_mm = 7850e-9 * 25 * 3
    rigidity = 210e3 * 25 * 3**3 / 12 * 1e3  # kg mm^3 / s^2
    expected = np.pi / (2 * 400**2) * np.sqrt(rigidity / mass_per_mm)

    moving = models.ringing_mm(scene, [1.0, 2.0], [0, 0.5 / expected, 20])

    assert models.frequency_hz(scene) == pytest.approx(expected)
    assert moving.shape == (3, 2)
    assert moving[0] == pytest.approx([0, 0])
    assert moving[1] == pytest.approx((1 + np.exp(-0.01 * np.pi)) * np.array([1, 2]), rel=1e-3)
    assert moving[2] == pytest.approx([1, 2], abs=1e-6)
    damped = models.change_scene(scene, beam={"damping_ratio": 0.2})
    stated = models.ringing_mm(scene, [1.0], [0.01], damping_ratio=0.2)
    assert models.ringing_mm(damped, [1.0], [0.01]) == pytest.approx(stated)
    with pytest.raises(SceneError, match="density_kg_m3"):
        models.frequency_hz(models.change_scene(scene, beam={"density_kg_m3": None}))


def own(
    length_mm: float = 400.0, load_mm: tuple[float, float] = (1.0, 399.0), force_n: tuple[float, float] = (2.0, 20.0)
) -> models.InfluenceFunction:
    """An influence function of a script's own."""
    return models.InfluenceFunction(length_mm, np.array(load_mm), force_n, lambda sensor, load: np.outer(load, sensor))


S, M = "the scene", "the model"
"""They stand for the scene and the model in the arguments below."""


@pytest.mark.parametrize(
    ("name", "arguments", "options", "said"),
    [
        ("influence_matrix", (S, [700], [10]), {}, r"sensor_mm: must be finite from 0 to 400"),
        ("influence_matrix", (S, [10], []), {}, "load_mm: must be one number, or a list of them"),
        ("influence_matrix", (S, ["a"], [10]), {}, "sensor_mm: must be numbers"),
        ("accuracy_limit", (S, [np.nan]), {}, r"sensor_mm: must be finite .* \(given: nan\)"),
        ("accuracy_limit", (S, [100, 300]), {"draws": 0}, "draws = 0: give a whole number, 1 or more"),
        ("accuracy_limit", (S, [100]), {"noise_mm": np.nan}, r"noise_mm: must be finite \(given: nan"),
        ("accuracy_limit", (S, [100]), {"noise_mm": 0}, "noise_mm = 0: must be more than 0"),
        ("error_along_mm", (S, [100, 300], [-5]), {}, "position_mm: must be finite from 1 to 399"),
        ("place", (S, 0), {}, "sensors = 0: give a whole number, 1 or more"),
        ("place", (S, 3), {"seed": -1}, "seed = -1: give a whole number, 0 or more"),
        ("place", ("bench.toml", 3), {}, "scene: give what read_scene returns, not str 'bench"),
        ("place", (S, 4), {"criterion": "best"}, "criterion = 'best' must be one of position-"),
        ("place", (S, 1), {"spare": 1}, "spare = 1 needs at least 2 sensors, not 1"),
        ("ringing_mm", (S, [1], [-1]), {}, r"time_s: must be finite, at least 0 \(given: -1\)"),
        ("ringing_mm", (S, [1], [0]), {"damping_ratio": 2}, "damping_ratio = 2 must be more than 0"),
        ("read_scene", ("absent.toml",), {}, "absent.toml: No such file"),
        ("read_scene", (5,), {}, "the scene: give a path or TOML text, not int"),
        ("build", (SCENE, "my name"), {}, "name = 'my name' must have 1 to 64 letters"),
        ("build", (S,), {"estimator": "best"}, "estimator = 'best' must be one of"),
        ("build", (S,), {"criterion": "best"}, "criterion = 'best' must be one of"),
        ("load_model", ("missing.onnx",), {}, "missing.onnx: No such file"),
        ("load_model", ("a\0b",), {}, r"'a\\x00b' cannot be the path of a file"),
        ("estimate", (M, [[1, 2, 3]]), {}, "deflection_mm: give finite numbers, 4 for each sample: s1"),
        ("estimate", (M, [1, 2, 3, 1e30]), {}, "deflection_mm: no load deflects this beam by more"),
        ("estimate", (M, ["1", "2", "3", "4"]), {}, "deflection_mm: must be numbers"),
        ("interpolate_influence", (S, [10, 390], [1, 399], [[1, 2], [3, 4]]), {}, "sensor_mm: give tw"),
        ("interpolate_influence", (S, [0, 400], [1, 200], [[1, 2], [3, 4]]), {}, "load_mm: give two"),
        ("interpolate_influence", (S, [0, 400], [1, 399], [[1, 2]]), {}, "matrix: give 2 rows"),
        ("place", (S, 3), {"influence": np.eye(3)}, "influence: give an InfluenceFunction, not ndarray"),
        (
            "place",
            (S, 3),
            {"influence": own(300.0, (1.0, 299.0))},
            "influence: its length_mm is 300, but that of the scene",
        ),
        (
            "accuracy_limit",
            (S, [9]),
            {"influence": own(force_n=(20.0, 200.0))},
            "its force_n is 20 to 200, but that of",
        ),
        (
            "evaluate",
            (M,),
            {"influence": own(load_mm=(10.0, 290.0))},
            "its load_mm is 10 to 290, but that of the scene",
        ),
        ("change_scene", (SCENE,), {}, "scene: give what read_scene returns, not str"),
        ("change_scene", (S,), {"sensors": None}, "sensors: give a table, as a dict of its keys, not NoneType"),
        ("format_scene", (SCENE,), {}, "scene: give what read_scene returns, not str"),
        ("evaluate", ("bench.onnx",), {}, "model: give what load_model returns"),
        ("evaluate", (M,), {"noise_mm": -1}, "noise_mm: must be finite, at least 0"),
    ],
)
def test_a_wrong_argument_is_refused_in_one_line(
    scene: models.Scene, bench: ModelFile, name: str, arguments: tuple[object, ...], options: dict[str, Any], said: str
) -> None:
    given = [scene if one is S else bench if one is M else one for one in arguments]
    with pytest.raises(InputError, match=said) as caught:
        getattr(models, name)(*given, **options)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("path", sorted(SCENES.glob("*.toml")), ids=lambda path: path.stem)
def test_a_scene_needs_no_text_and_can_be_written_as_one(path: Path) -> None:
    read = models.read_scene(path)

    made = models.make_scene(**tomllib.loads(path.read_text()))

    assert made == read
    text = models.format_scene(read)
    assert models.read_scene(text + "\n") == read
    lines = [line for line in text.splitlines() if line]
    # A header for each table, and a line for each key.
    assert len(lines) == sum(1 + len(table) for table in tomllib.loads(text).values())


def test_a_scene_is_changed_key_by_key(scene: models.Scene) -> None:
    changed = models.change_scene(scene, beam={"thickness_mm": 4}, requirements={"latency_ms": None})

    assert changed.beam.thickness_mm == 4
    assert changed.beam.length_mm == scene.beam.length_mm
    assert changed.requirements.latency_ms is None
    assert models.influence_matrix(changed, [200], [200]) < models.influence_matrix(scene, [200], [200])
    with pytest.raises(InputError, match="thickness_mm"):
        models.change_scene(scene, beam={"thickness_mm": -4})
    with pytest.raises(InputError, match="beem"):
        models.change_scene(scene, beem={"length_mm": 400})


def test_build_takes_a_scene_and_every_option_of_the_command(scene: models.Scene, tmp_path: Path) -> None:
    scene, path = models.change_scene(scene, sensors={"grid_mm": 19}), tmp_path / "bench.toml"
    path.write_text(models.format_scene(scene))
    options = ("--sensors", "2", "--criterion", "eigenvalue-product", "--seed", "3", "--effort", "0.06")
    files = ("-o", tmp_path / "bench.onnx", "--daemon-config", tmp_path / "told.toml")
    assert cli.main(["build", str(path), *options, *map(str, files)]) == 0

    config, report = tmp_path / "daemon.toml", str(tmp_path / "report.html")
    some: dict[str, Any] = {
        "sensors": 2,
        "criterion": "eigenvalue-product",
        "seed": 3,
        "effort": 0.06,
        "daemon_config": config,
        "report": report,
    }
    content = models.build(scene, "bench", **some)

    built, told = models.load_model(content), models.load_model(tmp_path / "bench.onnx")
    assert content == (tmp_path / "bench.onnx").read_bytes()
    assert models.read_scene(built.metadata.scene + "\n") == scene
    assert config.read_text() == (tmp_path / "told.toml").read_text()
    assert told.identity in (tmp_path / "report.html").read_text()


def test_build_takes_the_layout_that_was_placed(scene: models.Scene) -> None:
    layout = models.place(scene, 3, effort=ROUGH) + 1

    model = models.load_model(models.build(scene, sensor_mm=layout, effort=ROUGH))

    assert model.metadata.layout_mm == pytest.approx(layout)
    with pytest.raises(InputError, match="but sensor_mm has 3 positions"):
        models.build(scene, sensors=4, sensor_mm=layout)
    for wrong, said in (
        ([20.0, 900.0], "sensor_mm"),
        ([100.0, 100.0], "100 mm"),
        ([100.0, 101.0], "mm apart"),
        ([0.0, 200.0], "beyond the end"),
    ):
        with pytest.raises(InputError, match=said):
            models.build(scene, sensor_mm=wrong)


def test_a_table_of_influence_stands_in_for_the_beam(scene: models.Scene, bench_model: Path) -> None:
    """A table of the same beam gives the same figures; one of a beam of twice the stiffness gives larger errors."""
    sensors, layout = np.linspace(0, 400, 81), [68.0, 156.0, 244.0, 332.0]
    loads = np.linspace(1, 399, 80)
    table = models.influence_matrix(scene, sensors, loads)
    same, stiff = (models.interpolate_influence(scene, sensors, loads, factor * table) for factor in (1.0, 0.5))

    limits = [models.accuracy_limit(scene, layout, draws=300, influence=own).mean_mm for own in (None, same, stiff)]
    assert limits[1] == pytest.approx(limits[0], rel=1e-3)
    assert 1.5 < limits[2] / limits[0] < 2.1
    layouts = [
        models.place(scene, 2, criterion="eigenvalue-product", influence=own, effort=ROUGH) for own in (None, same)
    ]
    assert layouts[0] == pytest.approx(layouts[1], abs=2)

    model = models.load_model(bench_model)
    own, beam, other = (models.evaluate(model, draws=200, influence=own).span for own in (same, None, stiff))
    assert own.mean_mm.value == pytest.approx(beam.mean_mm.value, rel=1e-3)
    assert other.mean_mm.value > 1.5 * beam.mean_mm.value


def test_an_influence_of_ones_own_is_that_of_the_beam_and_a_calibrated_model_knows_its_gains(
    scene: models.Scene, bench: ModelFile
) -> None:
    sensors, loads = np.linspace(0, 400, 81), np.linspace(1, 399, 80)
    own = models.interpolate_influence(scene, sensors, loads, models.influence_matrix(scene, sensors, loads))
    departures = bench.metadata.departures.model_copy(update={"gain": [1.3, 0.7, 1.3, 0.7]})
    fitted = Calibration(
        departures=departures, fitted=["gain"], loads=9, residual_mm=0.0, error_before_mm=9.0, error_after_mm=1.0
    )
    model = replace(bench, metadata=bench.metadata.model_copy(update={"calibration": fitted}))
    told, beam = (models.evaluate(model, draws=200, influence=one).span.mean_mm.value for one in (own, None))
    assert told == pytest.approx(beam, rel=0.1)


def test_evaluate_gives_what_the_command_prints(bench_model: Path, capsys: pytest.CaptureFixture[str]) -> None:
    asked = ("--draws", "500", "--noise", "0.01", "--json", "--workers", "1")
    assert cli.main(["evaluate", str(bench_model), *asked]) == 0
    printed = json.loads(capsys.readouterr().out)["evaluations"][0]

    found = models.evaluate(models.load_model(bench_model), noise_mm=0.01, draws=500)

    assert printed["span"]["mean_mm"]["value"] == found.span.mean_mm.value
    assert found.span.ratio is not None
    assert found.span.ratio.value == printed["span"]["ratio"]["value"]
