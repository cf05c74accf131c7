"""The interface for scripts gives what the commands give, and its results can be passed on."""

import json
import pickle
import re
import tomllib
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import pytest

import beamtouch_models as models
from beamtouch_common.errors import InputError
from beamtouch_models import cli
from beamtouch_models.errors import SceneError
from beamtouch_models.runtime import Calibration
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
    surface = models.resolve(models.change_scene(scene, sensors={"grid_mm": 8}))
    best, papers = surface.place(2), surface.place(2, criterion="eigenvalue-product")
    least, theirs = (layout.limit(draws=2000) for layout in (best, papers))

    assert least.value < theirs.value
    assert 0 < least.standard_error < 0.1 * least.value


def test_the_error_along_the_beam_has_the_mean_of_the_limit(scene: models.Scene) -> None:
    layout, place = models.resolve(scene).layout([68, 156, 244, 332]), 1 + 398 * (np.arange(80) + 0.5) / 80
    limit = layout.limit(draws=4000)

    along = layout.error_along(place, draws=50)

    assert along.position_mm == pytest.approx(place)
    assert along.error_mm.mean() == pytest.approx(limit.value, rel=0.1)
    assert along.error_mm[0] > along.error_mm[40]
    more = layout.error_along(place, draws=200, seed=1)
    off = np.abs(along.error_mm - more.error_mm) / np.hypot(along.standard_error_mm, more.standard_error_mm)
    assert 0.5 < np.sqrt(np.mean(off**2)) < 1.5  # standard errors say how far two seeds are apart
    assert layout.error_along(draws=2).position_mm == pytest.approx(np.linspace(1, 399, 41))


def test_the_error_at_a_place_scatters_as_its_standard_error_says(scene: models.Scene) -> None:
    """Over the same place again and again, of two contacts each, the variance of the means is the mean of squares."""
    again = models.resolve(scene).layout([68, 156, 244, 332]).error_along(np.full(300, 130.0), draws=2, seed=4)
    assert again.error_mm.var() == pytest.approx((again.standard_error_mm**2).mean(), rel=0.25)


def test_simulated_samples_scatter_about_the_deflections_of_their_contacts_by_the_errors(scene: models.Scene) -> None:
    surface = models.resolve(scene)
    layout = surface.layout([68, 156, 244, 332])
    clean = models.influence_matrix(scene, layout.positions_mm, [130.0])[0]
    samples = layout.simulate(np.full(2000, 130.0), 10, seed=2)
    expected = np.hypot(
        np.hypot(surface.errors.noise_mm, surface.errors.zero_mm), 10 * float(np.max(surface.errors.gain)) * clean
    )
    assert samples.std(axis=0) == pytest.approx(expected, rel=0.08)
    assert samples.mean(axis=0) == pytest.approx(10 * clean, abs=5 * expected.max() / 2000**0.5)
    assert layout.simulate([130.0, 260.0], [10, 4], seed=2).shape == (2, 4)
    weak, strong = layout.simulate([130.0, 130.0], [2, 20], seed=5)
    assert strong == pytest.approx(20 * clean, rel=0.05)
    assert weak == pytest.approx(2 * clean, rel=0.05)
    assert not np.array_equal(layout.simulate(130.0, 10, seed=1), layout.simulate(130.0, 10))
    assert np.array_equal(layout.simulate(130.0, 10, seed=0), layout.simulate(130.0, 10))


def test_a_model_locates_the_load_that_bent_the_beam(scene: models.Scene, bench_model: Path) -> None:
    model = models.load_model(bench_model)
    sensors = [channel.position_mm for channel in model.metadata.layout]

    found = model.estimate(10 * models.influence_matrix(scene, sensors, [100, 250]))

    assert found["position_mm"] == pytest.approx([100, 250], abs=2)
    assert found["force_n"] == pytest.approx([10, 10], rel=0.02)
    assert np.all(found["position_low_mm"] < found["position_high_mm"])
    assert {name: values.shape for name, values in model.estimate(np.empty((0, 4))).items()} == dict.fromkeys(
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


def test_a_chain_of_calls_makes_the_file_that_the_command_writes(scene: models.Scene, tmp_path: Path) -> None:
    scene, path = models.change_scene(scene, sensors={"grid_mm": 19}), tmp_path / "bench.toml"
    path.write_text(models.format_scene(scene))
    options = ("--sensors", "2", "--criterion", "eigenvalue-product", "--seed", "3", "--effort", "0.06")
    files = ("-o", tmp_path / "bench.onnx", "--daemon-config", tmp_path / "daemon.toml")
    assert cli.main(["build", str(path), *options, *map(str, files)]) == 0

    layout = models.resolve(scene).place(2, criterion="eigenvalue-product", seed=3, effort=ROUGH)
    model = layout.build("bench", seed=3)
    model.save(tmp_path / "script.onnx")

    assert (tmp_path / "script.onnx").read_bytes() == (tmp_path / "bench.onnx").read_bytes()
    assert models.load_model(tmp_path / "script.onnx").identity == model.identity
    assert models.read_scene(model.metadata.scene + "\n") == scene
    assert models.daemon_config(model.metadata) == (tmp_path / "daemon.toml").read_text()


def test_a_model_is_built_for_the_sensors_that_are_mounted(scene: models.Scene) -> None:
    surface = models.resolve(scene)
    moved = surface.place(3, effort=ROUGH).positions_mm + 1

    model = surface.layout(moved).build(effort=ROUGH)

    assert model.metadata.layout_mm == pytest.approx(moved)


def test_links_of_the_chain_say_what_they_are(scene: models.Scene, bench_model: Path) -> None:
    surface, model = models.resolve(scene), models.load_model(bench_model)

    assert repr(surface) == "Surface(400 mm long, contacts at 1..399 mm with 2..20 N, 0.00226 mm of noise a sample)"
    assert repr(surface.layout([100.0, 300.0])) == "Layout(sensors at 100, 300 mm)"
    assert re.fullmatch(
        r"Model\(bench@\w{6}, posterior, sensors at [\d, ]+ mm, mean error [\d.]+ % of 400 mm\)", repr(model)
    )
    assert set(dir(models)) == set(models.__all__)


def test_a_model_goes_to_another_process(bench_model: Path) -> None:
    model = models.load_model(bench_model)
    sample = np.full((1, len(model.channels)), 0.1)

    with ProcessPoolExecutor(1, get_context("spawn")) as pool:
        there = pool.submit(models.Model.estimate, model, sample).result()

    here = model.estimate(sample)
    assert repr(there) == repr(here) == "unexplained: not one contact, or a wrong sensor"
    assert there["misfit"] == here["misfit"]


@pytest.mark.parametrize("link", ["scene", "surface", "layout", "model", "limit", "evaluation", "estimates"])
def test_each_link_and_result_can_be_pickled(scene: models.Scene, bench_model: Path, link: str) -> None:
    surface, model = models.resolve(scene), models.load_model(bench_model)
    layout = surface.layout([100.0, 300.0])
    made: dict[str, Callable[[], object]] = {
        "scene": lambda: scene,
        "surface": lambda: surface,
        "layout": lambda: layout,
        "model": lambda: model,
        "limit": lambda: layout.limit(draws=64),
        "evaluation": lambda: model.evaluate(draws=64),
        "estimates": lambda: model.estimate(layout.simulate(200, 10)[:, [0, 0, 1, 1]]),
    }
    given = made[link]()
    assert repr(pickle.loads(pickle.dumps(given))) == repr(given)  # noqa: S301  # it was made here


@pytest.mark.promise(
    "docs/reference/python.md",
    "Results print no more digits than they are known to",
)
def test_results_print_no_more_than_four_digits(scene: models.Scene, bench_model: Path) -> None:
    surface, model = models.resolve(scene), models.load_model(bench_model)
    layout = surface.layout([100.0, 300.0])
    results = (
        surface.travel, surface.readings, surface.errors, surface.effects, surface.ringing, surface.noise,
        surface.sensor, surface.filter, layout.placement, layout.limit(draws=64), layout.error_along([50, 200]),
        model.evaluate(draws=64), model.metadata, model.estimate(layout.simulate([50, 200], 10)[:, [0, 0, 1, 1]]),
    )  # fmt: skip
    for result in results:
        long = [
            number for number in re.findall(r"\d+\.\d+", str(result)) if len(number.replace(".", "").lstrip("0")) > 4
        ]
        assert not long, str(result)
        assert len(str(result)) < 5000
    assert str(models.Measurement(2.8123, 0.0345)) == repr(models.Measurement(2.8123, 0.0345)) == "2.81 +- 0.03"


def test_estimates_are_told_in_words_with_the_decimals_that_they_are_worth(
    scene: models.Scene, bench_model: Path
) -> None:
    model = models.load_model(bench_model)
    sensors = model.metadata.layout_mm
    load = 10 * models.influence_matrix(scene, sensors, [150])[0]
    two = np.where([True, True, False, False], load, np.nan)
    told = str(model.estimate(np.stack([load, two, 0 * load, load * [1, -1, 1, -1]]))).splitlines()
    assert re.fullmatch(r"contact at 15\d\.\d+ mm \(14\d\.\d+ to 15\d\.\d+\) with \d+\.\d+ N \(.* to .*\)", told[0]), (
        told
    )
    assert told[1].endswith("; 2 channels hardly tell it from other loads")
    assert told[2:] == ["clear, nothing touches", "unexplained: not one contact, or a wrong sensor"]
    assert str(model.estimate(np.empty((0, 4)))) == ""


@pytest.mark.promise(
    "docs/reference/python.md",
    "NaN stands for a sensor that is out, and `evaluate(missing=...)` measures the model without it",
)
def test_a_model_is_tried_without_a_sensor(scene: models.Scene, bench_model: Path) -> None:
    model = models.load_model(bench_model)
    three = models.resolve(scene).layout(model.metadata.layout_mm[1:])
    without, whole = (model.evaluate(draws=2000, missing=out) for out in (["s1"], []))
    assert without.span.limit_mean_mm is not None
    limit = three.limit(draws=2000)
    off = without.span.limit_mean_mm.value - limit.value
    assert abs(off) < 4 * np.hypot(limit.standard_error, without.span.limit_mean_mm.standard_error)
    assert without.span.ratio is not None
    assert without.span.ratio.value < 1.05
    assert without.span.mean_mm.value > 1.1 * whole.span.mean_mm.value
    assert without.position_coverage is not None
    assert 0.92 < without.position_coverage.value < 0.98
    assert without.unexplained is not None
    assert without.unexplained.value < 0.01


def test_a_table_of_influence_stands_in_for_the_beam(scene: models.Scene, bench_model: Path) -> None:
    """A table of the same beam gives the same figures; one of a beam of twice the stiffness gives larger errors."""
    noise = {
        "noise_percent_of_max": None,
        "noise_mm": models.resolve(scene).noise.reading_mm,
    }  # of the beam's deflection
    measured = models.change_scene(scene, beam=None, sensors=noise)
    sensors, positions_mm = np.linspace(0, 400, 81), [68.0, 156.0, 244.0, 332.0]
    loads = np.linspace(1, 399, 80)
    table = models.influence_matrix(scene, sensors, loads)
    same, stiff = (models.interpolate_influence(measured, sensors, loads, factor * table) for factor in (1.0, 0.5))
    surfaces = [models.resolve(scene), *(models.resolve(measured, influence=own) for own in (same, stiff))]

    limits = [surface.layout(positions_mm).limit(draws=300).value for surface in surfaces]
    assert limits[1] == pytest.approx(limits[0], rel=1e-3)
    assert 1.5 < limits[2] / limits[0] < 2.1
    layouts = [surface.place(2, criterion="eigenvalue-product", effort=ROUGH).positions_mm for surface in surfaces[:2]]
    assert layouts[0] == pytest.approx(layouts[1], abs=2)
    with pytest.raises(InputError, match="a model file holds the scene's beam, not an influence function of your own"):
        surfaces[1].layout(positions_mm).build()

    model = models.load_model(bench_model)
    own, beam, other = (model.evaluate(draws=200, influence=own).span for own in (same, None, stiff))
    assert own.mean_mm.value == pytest.approx(beam.mean_mm.value, rel=1e-3)
    assert other.mean_mm.value > 1.5 * beam.mean_mm.value


def test_an_influence_of_ones_own_is_that_of_the_beam_and_a_calibrated_model_knows_its_gains(
    scene: models.Scene, bench_model: Path
) -> None:
    sensors, loads = np.linspace(0, 400, 81), np.linspace(1, 399, 80)
    own = models.interpolate_influence(scene, sensors, loads, models.influence_matrix(scene, sensors, loads))
    fresh = models.load_model(bench_model)
    departures = fresh.metadata.departures.model_copy(update={"gain": [1.3, 0.7, 1.3, 0.7]})
    fitted = Calibration(
        departures=departures, fitted=["gain"], loads=9, residual_mm=0.0, error_before_mm=9.0, error_after_mm=1.0
    )
    model = replace(fresh, metadata=fresh.metadata.model_copy(update={"calibration": fitted}))
    told, beam = (model.evaluate(draws=200, influence=one).span.mean_mm.value for one in (own, None))
    assert told == pytest.approx(beam, rel=0.1)


def test_evaluate_gives_what_the_command_prints(bench_model: Path, capsys: pytest.CaptureFixture[str]) -> None:
    asked = ("--draws", "500", "--noise", "0.01", "--json", "--workers", "1")
    assert cli.main(["evaluate", str(bench_model), *asked]) == 0
    printed = json.loads(capsys.readouterr().out)["evaluations"][0]

    found = models.load_model(bench_model).evaluate(noise_mm=0.01, draws=500)

    assert printed["span"]["mean_mm"]["value"] == found.span.mean_mm.value
    assert found.span.ratio is not None
    assert found.span.ratio.value == printed["span"]["ratio"]["value"]
