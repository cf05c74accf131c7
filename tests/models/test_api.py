"""The interface for scripts gives what the commands give, and refuses with one line."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from beamtouch_common.errors import InputError
from beamtouch_models import api
from beamtouch_models.errors import SceneError
from beamtouch_models.physics.dynamics import FIRST_ROOT
from example_scenes import SCENES

SCENE = (SCENES / "bench.toml").read_text()


@pytest.fixture
def scene() -> api.Scene:
    return api.read_scene(SCENES / "bench.toml")


def test_everything_public_has_a_docstring() -> None:
    assert all(getattr(api, name).__doc__ for name in api.__all__)


def test_a_scene_is_read_from_a_file_and_from_text(scene: api.Scene) -> None:
    assert api.read_scene(SCENE) == scene
    with pytest.raises(InputError, match="beem"):
        api.read_scene("[beem]\nlength_mm = 400")


def test_the_influence_of_a_load_in_the_middle_is_that_of_the_handbook(scene: api.Scene) -> None:
    rigidity_n_mm2 = 210e3 * 25 * 3**3 / 12  # E I; F l^3 / (48 E I)

    (found,) = api.influence_matrix(scene, [200], [200])

    assert found == pytest.approx([400**3 / (48 * rigidity_n_mm2)])


def test_the_layout_of_least_error_is_no_worse_than_that_of_the_paper(scene: api.Scene) -> None:
    layouts = [api.place(scene, 2, criterion=name) for name in ("position-error", "eigenvalue-product")]
    best, papers = (api.accuracy_limit(scene, layout, draws=2000) for layout in layouts)

    assert best.mean_mm < papers.mean_mm
    assert best.percent == pytest.approx(best.mean_mm / 4)
    assert 0 < best.standard_error_mm < 0.1 * best.mean_mm


def test_the_error_along_the_beam_has_the_mean_of_the_limit(scene: api.Scene) -> None:
    layout, place = [68, 156, 244, 332], 1 + 398 * (np.arange(80) + 0.5) / 80
    limit = api.accuracy_limit(scene, layout)

    along = api.error_along_mm(scene, layout, place, draws=100)

    assert along.shape == (80,)
    assert along.mean() == pytest.approx(limit.mean_mm, rel=0.1)
    assert along[0] > along[40]


def test_more_noise_means_more_error(scene: api.Scene) -> None:
    low, high = (api.accuracy_limit(scene, [68, 332], noise_mm=noise, draws=500).mean_mm for noise in (1e-3, 1e-2))

    assert low < high


def test_a_model_locates_the_load_that_bent_the_beam(scene: api.Scene, bench_model: Path) -> None:
    model = api.load_model(bench_model)
    sensors = [channel.position_mm for channel in model.metadata.layout]

    found = api.estimate(model, 10 * api.influence_matrix(scene, sensors, [100, 250]))

    assert found["position_mm"] == pytest.approx([100, 250], abs=2)
    assert found["force_n"] == pytest.approx([10, 10], rel=0.02)
    assert np.all(found["position_low_mm"] < found["position_high_mm"])
    assert api.load_model(bench_model.read_bytes()).identity == model.identity


@pytest.mark.usefixtures("short_measuring")
def test_a_model_is_built_from_text(tmp_path: Path) -> None:
    (tmp_path / "bench.toml").write_text(SCENE)

    content = api.build(tmp_path / "bench.toml", "bench", sensors=2)

    assert len(api.load_model(content).metadata.layout) == 2


def test_a_touched_beam_rings_around_its_deflection(scene: api.Scene) -> None:
    mass_per_mm = 7850e-9 * 25 * 3
    rigidity = 210e3 * 25 * 3**3 / 12 * 1e3  # kg mm^3 / s^2
    expected = FIRST_ROOT["simply-supported"] ** 2 / (2 * np.pi * 400**2) * np.sqrt(rigidity / mass_per_mm)

    moving = api.ringing_mm(scene, [1.0, 2.0], [0, 0.5 / expected, 20])

    assert api.frequency_hz(scene) == pytest.approx(expected)
    assert moving.shape == (3, 2)
    assert moving[0] == pytest.approx([0, 0])
    assert moving[1] == pytest.approx((1 + np.exp(-0.01 * np.pi)) * np.array([1, 2]), rel=1e-3)
    assert moving[2] == pytest.approx([1, 2], abs=1e-6)


def test_a_beam_of_unknown_mass_has_no_frequency() -> None:
    massless = api.read_scene(SCENE.replace("density_kg_m3 = 7850", ""))

    with pytest.raises(SceneError, match="density_kg_m3"):
        api.frequency_hz(massless)


def test_a_touched_beam_rings_with_the_damping_of_its_scene(scene: api.Scene) -> None:
    damped = api.read_scene(SCENE.replace("density_kg_m3 = 7850", "density_kg_m3 = 7850\ndamping_ratio = 0.2"))

    assert api.ringing_mm(damped, [1.0], [0.01]) == pytest.approx(
        api.ringing_mm(scene, [1.0], [0.01], damping_ratio=0.2)
    )


def test_a_spare_costs_error_and_saves_some_when_a_sensor_fails(scene: api.Scene) -> None:
    without, with_spare = (api.place(scene, 3, spare=spare) for spare in (0, 1))

    def worst(layout: np.ndarray) -> float:
        return max(api.accuracy_limit(scene, np.delete(layout, index), draws=2000).mean_mm for index in range(3))

    assert worst(with_spare) < worst(without)


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda scene, _: api.influence_matrix(scene, [700], [10]), r"sensor_mm: must be finite from 0 to 400"),
        (lambda scene, _: api.influence_matrix(scene, [10], []), "load_mm: must be one number, or a list of them"),
        (lambda scene, _: api.influence_matrix(scene, ["a"], [10]), "sensor_mm: must be numbers"),
        (lambda scene, _: api.accuracy_limit(scene, [np.nan]), r"sensor_mm: must be finite .* \(given: nan\)"),
        (lambda scene, _: api.accuracy_limit(scene, [100, 300], draws=0), "draws = 0: give a whole number, 1 or more"),
        (lambda scene, _: api.accuracy_limit(scene, [100], noise_mm=np.nan), r"noise_mm: must be finite \(given: nan"),
        (lambda scene, _: api.accuracy_limit(scene, [100], noise_mm=0), "noise_mm = 0: must be more than 0"),
        (lambda scene, _: api.error_along_mm(scene, [100, 300], [-5]), "position_mm: must be finite from 1 to 399"),
        (lambda scene, _: api.place(scene, 0), "sensors = 0: give a whole number, 1 or more"),
        (lambda scene, _: api.place(scene, cast("Any", "3")), "sensors = '3': give a whole number, 1 or more"),
        (lambda scene, _: api.place(scene, 3, seed=-1), "seed = -1: give a whole number, 0 or more"),
        (lambda *_: api.place(cast("Any", "bench.toml"), 3), "scene: give what read_scene returns, not str 'bench"),
        (
            lambda scene, _: api.place(scene, 4, criterion=cast("Any", "best")),
            "criterion = 'best' must be one of position-",
        ),
        (lambda scene, _: api.place(scene, 1, spare=1), "spare = 1: give 0, or 1 with two or more sensors"),
        (lambda scene, _: api.ringing_mm(scene, [1], [-1]), r"time_s: must be finite, at least 0 \(given: -1\)"),
        (lambda scene, _: api.ringing_mm(scene, [1], [0], damping_ratio=2), "damping_ratio = 2 must be more than 0"),
        (lambda *_: api.read_scene("bench.toml"), r"give Path\('bench.toml'\)"),
        (lambda *_: api.build("bench.toml"), r"give Path\('bench.toml'\)"),
        (lambda *_: api.build(SCENE, "my name"), "name = 'my name' must have 1 to 64 letters"),
        (lambda *_: api.load_model("missing.onnx"), "missing.onnx: No such file"),
        (
            lambda _, model: api.estimate(model, [[1, 2, 3]]),
            "deflection_mm: give finite numbers, 4 for each sample: s1",
        ),
        (lambda _, model: api.estimate(model, [[1, 2, 3, np.nan]]), "deflection_mm: give finite numbers, 4 for each"),
        (lambda _, model: api.estimate(model, [1, 2, 3, 1e30]), "deflection_mm: no load deflects this beam by more"),
        (lambda _, model: api.estimate(model, cast("Any", ["1", "2", "3", "4"])), "deflection_mm: must be numbers"),
        (lambda *_: api.load_model("a\0b"), r"'a\\x00b' cannot be the path of a file"),
    ],
)
def test_a_wrong_argument_is_refused_in_one_line(
    scene: api.Scene, bench_model: Path, call: Callable[[api.Scene, api.ModelFile], object], said: str
) -> None:
    with pytest.raises(InputError, match=said) as caught:
        call(scene, api.load_model(bench_model))
    assert "\n" not in str(caught.value)
