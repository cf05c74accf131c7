"""Structures whose influence was measured: models of what no scene describes."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from beamtouch_models import change_scene, influence_matrix, load_model, make_scene, resolve
from beamtouch_models.arrays import Floats
from beamtouch_models.design.physics.measured_structure import measured_structure_of
from beamtouch_models.design.scene import identity_of, parse_scene
from beamtouch_models.errors import InputError
from models.calibration_files import write_contacts
from support.programs.in_process import Command
from support.surfaces.example_scenes import PAPER
from support.surfaces.tapered_leaf import (
    SENSORS_MM,
    STATED,
    influence,
    loads_csv,
    scene_of,
    true_influence,
    write_scene,
)

EFFORT, DRAWS = 0.05, 4000


@pytest.mark.soak
def test_a_model_of_measured_loads_is_nearly_as_good_as_one_that_knew_the_structure() -> None:
    of_truth = resolve(STATED, influence=true_influence()).layout(list(SENSORS_MM.values())).limit(draws=DRAWS)
    for loads, worst in ((12, 1.5), (25, 1.25), (50, 1.2)):
        model = resolve(scene_of(influence=loads_csv(loads))).place().build("leaf", effort=EFFORT)
        found = model.evaluate(influence=true_influence(), draws=DRAWS)
        assert of_truth.value < found.span.mean_mm.value < worst * of_truth.value, (loads, found, of_truth)
        assert found.position_coverage is not None
        assert found.position_coverage.value > 0.93


def test_the_beam_of_a_scene_is_found_in_twenty_loads() -> None:
    beam = make_scene(
        beam={"length_mm": 400, "material": "steel", "width_mm": 25, "thickness_mm": 3},
        contact={"force_n": [2, 20], "position_mm": [10, 390]},
        sensors={"noise_mm": 0.002, "rate_hz": 100, "count": 3},
    )
    candidates_mm, place_mm = np.arange(20.0, 390.0, 20.0), np.linspace(10, 390, 20)
    rng = np.random.default_rng(1)
    table = influence_matrix(beam, candidates_mm, place_mm)
    table *= 1 + 0.001 * rng.normal(size=table.shape)
    names = [f"s{place:g}" for place in candidates_mm]
    head = ",".join(["position_mm", *(f"{name}_mm_per_n" for name in names)])
    rows = [",".join(map(str, row)) for row in np.column_stack([place_mm, table]).tolist()]
    measured = change_scene(
        beam,
        beam=None,
        measured={
            "influence": "\n".join([head, *rows]),
            "length_mm": 400,
            "sensors_mm": dict(zip(names, candidates_mm.tolist(), strict=True)),
        },
    )
    by_table, by_theory = (resolve(scene).place(3, effort=EFFORT) for scene in (measured, beam))
    assert np.abs(by_table.positions_mm - by_theory.positions_mm).max() <= 30
    there = by_table.positions_mm
    limit = resolve(beam).layout(there).limit(draws=DRAWS).value
    found = by_table.build("strip", effort=EFFORT).evaluate(influence=resolve(beam).influence, draws=DRAWS)
    assert limit < found.span.mean_mm.value < 1.1 * limit
    assert found.position_coverage is not None
    assert found.position_coverage.value > 0.93


@pytest.mark.promise("docs/reference/scene.md", "the model file holds the table")
def test_a_model_holds_its_table(tmp_path: Path, design_sensors_roughly: Command) -> None:
    scene = write_scene(tmp_path, loads_csv(20))
    built = design_sensors_roughly("build", scene, "-o", tmp_path / "leaf.onnx", "--report", tmp_path / "leaf.html")
    assert built.returncode == 0, built.stderr
    assert "fixed_mm" not in built.stdout
    assert "The structure as a line" in (tmp_path / "leaf.html").read_text()
    for path in (scene, tmp_path / "leaf.csv"):
        path.unlink()
    again = design_sensors_roughly("build", tmp_path / "leaf.onnx", "-o", tmp_path / "again.onnx")
    assert again.returncode == 0, again.stderr
    first, second = (load_model(tmp_path / name) for name in ("leaf.onnx", "again.onnx"))
    assert [channel.name for channel in first.metadata.layout] == list(SENSORS_MM)
    assert first.identity == second.identity
    deflection_mm = 10 * influence(first.metadata.layout_mm, np.array([180.0]))
    assert abs(first.estimate(deflection_mm)["position_mm"][0] - 180) < 3


@pytest.mark.soak
def test_gains_of_a_measured_structure_are_calibrated(tmp_path: Path, design_sensors_roughly: Command) -> None:
    scene, sensors_mm = write_scene(tmp_path, loads_csv(25)), np.array(list(SENSORS_MM.values()))
    assert design_sensors_roughly("build", scene, "-o", tmp_path / "leaf.onnx").returncode == 0
    rng, gain = np.random.default_rng(3), np.array([1.05, 0.97, 1.0, 1.0])
    rows = ["load,position_mm,force_n," + ",".join(f"{name}_deflection_mm" for name in SENSORS_MM)]
    for load, place in enumerate(np.linspace(30, 270, 9), start=1):
        shown = gain * 10 * influence(sensors_mm, np.array([place]))[0]
        rows += [
            f"{load},{place:g},10," + ",".join(f"{mm:.5f}" for mm in shown + 0.004 * rng.normal(size=4))
            for _ in range(6)
        ]
    (tmp_path / "loads.csv").write_text("\n".join(rows))
    done = design_sensors_roughly(
        "calibrate", tmp_path / "leaf.onnx", tmp_path / "loads.csv", "-o", tmp_path / "calibrated.onnx"
    )
    assert done.returncode == 0, done.stderr
    before, after = (load_model(tmp_path / name).metadata for name in ("leaf.onnx", "calibrated.onnx"))
    assert after.beam == before.beam
    assert np.abs(np.array(after.departures.gain) / after.departures.rigidity - gain).max() < 0.015
    assert after.departures.position_offset_mm == [0.0] * 4
    place_mm, force_n = rng.uniform(20, 280, 60), rng.uniform(3, 20, 60)
    deviation_mm = np.full((60, 4), 0.5 * before.noise.sample_mm)
    shown = gain * force_n[:, None] * influence(sensors_mm, place_mm) + deviation_mm * rng.normal(size=(60, 4))
    events = write_contacts(tmp_path / "events.csv", load_model(tmp_path / "leaf.onnx"), shown, deviation_mm)
    done = design_sensors_roughly(
        "calibrate", tmp_path / "leaf.onnx", "--events", events, "-o", tmp_path / "calibrated.onnx"
    )
    assert done.returncode == 0, done.stderr
    of_contacts = np.array(load_model(tmp_path / "calibrated.onnx").metadata.departures.gain)
    assert np.abs(of_contacts / of_contacts.mean() - gain / gain.mean()).max() < 0.03


def test_sensors_whose_places_are_not_stated_stand_where_they_show_most() -> None:
    scene = change_scene(scene_of(influence=loads_csv(28)), measured={"sensors_mm": None})
    assert scene.measured is not None
    for name, place_mm in scene.measured.places_mm.items():
        along_mm = np.linspace(15, 285, 271)
        most_mm = along_mm[influence(np.array([SENSORS_MM[name]]), along_mm)[:, 0].argmax()]
        assert abs(place_mm - most_mm) <= 15, name


def test_a_table_of_influence_tells_the_same_as_its_loads() -> None:
    place_mm = np.linspace(15, 285, 20)
    rows = np.column_stack([place_mm, influence(np.array(list(SENSORS_MM.values())), place_mm)])
    head = ",".join(["position_mm", *(f"{name}_mm_per_n" for name in SENSORS_MM)])
    table = "\n".join([head, *(",".join(map(str, row)) for row in rows.tolist())])
    between = np.linspace(20, 280, 14)
    surface = resolve(scene_of(influence=table))
    told = surface.influence.at(np.array(list(SENSORS_MM.values()))[:, None], between[:, None])
    assert np.allclose(told, influence(np.array(list(SENSORS_MM.values())), between), rtol=0.01)


def recorded_loads(places_mm: Floats, forces_n: list[float], shown: Callable[[Floats], Floats]) -> str:
    """Return loads with eight samples each, as `beamtouch-daemon record` writes them; `shown` is what sensors do."""
    rng, sensors_mm = np.random.default_rng(2), np.array(list(SENSORS_MM.values()))
    columns = [f"{name}_{column}" for name in SENSORS_MM for column in ("counts", "deflection_mm", "quality")]
    rows, load = [",".join(["unix_time_s", "load", "position_mm", "force_n", *columns])], 0
    for place in places_mm.tolist():
        for force in forces_n:
            load += 1
            mm = shown(force * influence(sensors_mm, np.array([place]))[0])
            for sample in range(8):
                cells = [f"2000,{value:.6f},good" for value in mm + 0.004 * rng.normal(size=len(mm))]
                rows.append(
                    ",".join([f"{60 * load + sample / 100:.2f}", str(load), f"{place:g}", f"{force:g}", *cells])
                )
    return "\n".join(rows) + "\n"


def as_they_are(deflection_mm: Floats) -> Floats:
    return deflection_mm


@pytest.mark.promise("docs/how-to/measured.md", "without a scene: what the loads tell is taken from them")
def test_loads_alone_make_a_model(tmp_path: Path, design_sensors_roughly: Command) -> None:
    (tmp_path / "leaf.csv").write_text(recorded_loads(np.linspace(15, 285, 24), [10.0], as_they_are))
    done = design_sensors_roughly("build", "--loads", tmp_path / "leaf.csv", "-o", tmp_path / "leaf.onnx")
    assert done.returncode == 0, done.stderr
    assert "contacts at 15 to 285 mm with 2 to 10 N" in " ".join(done.stderr.split())
    assert "so each is drawn where it shows most: " in done.noted
    assert "interpolation between the loads of the table costs" in " ".join(done.stderr.split())
    model = load_model(tmp_path / "leaf.onnx")
    assert 0.003 < model.metadata.noise.reading_mm < 0.005
    assert model.metadata.sensor.rate_hz == pytest.approx(100, rel=0.01)
    by_name = dict(zip(model.channels, model.metadata.layout_mm, strict=True))
    assert set(by_name) == set(SENSORS_MM)
    deflection_mm = 8 * influence(np.array([SENSORS_MM[name] for name in by_name]), np.array([100.0]))
    assert abs(model.estimate(deflection_mm)["position_mm"][0] - 100) < 4


def optical(deflection_mm: Floats) -> Floats:
    """Return what a sensor shows whose light falls with the square of the gap, of 4 mm at rest."""
    return (4.0 / (4.0 - deflection_mm)) ** 2 - 1


@pytest.mark.soak
@pytest.mark.promise("docs/how-to/measured.md", "a characteristic is fitted for each sensor from the same loads")
def test_curved_sensors_are_straightened_by_their_own_loads() -> None:
    table = recorded_loads(np.linspace(15, 285, 24), [3.0, 6.0, 12.0, 20.0], optical)
    scene = change_scene(scene_of(influence=table, curved=True), sensors={"range_mm": [1, 19]})
    model = resolve(scene).place().build("leaf", effort=EFFORT)
    rng = np.random.default_rng(4)
    place_mm, force_n = rng.uniform(20, 280, 300), rng.uniform(3, 20, 300)
    straight_mm = force_n[:, None] * influence(model.metadata.layout_mm, place_mm)
    shown = model.straighten(optical(straight_mm) + 0.004 / np.sqrt(5) * rng.normal(size=straight_mm.shape))
    answers = model.estimate(shown.deflection_mm, noise_mm=shown.noise_mm / np.sqrt(5))
    is_contact = answers["state"] == "contact"
    assert is_contact.mean() > 0.95
    held = (answers["position_low_mm"] <= place_mm) & (place_mm <= answers["position_high_mm"])
    assert held[is_contact].mean() > 0.9
    off_mm = np.abs(answers["position_mm"] - place_mm)[is_contact].mean()
    assert off_mm < 1.0
    with pytest.raises(InputError, match="as if loads did not stand where the table says"):
        resolve(change_scene(scene, measured={"curved": False}))
    with pytest.raises(InputError, match=r"contact\.force_n goes to 40 N, but the heaviest load of the table is 20 N"):
        resolve(change_scene(scene, contact={"force_n": [3, 40]}))


def test_contacts_on_a_small_part_of_a_long_structure_are_told_as_well() -> None:
    """The fit is evaluated as finely as contacts need, however long the structure is."""
    between, sensors_mm = np.linspace(20, 280, 14)[:, None], np.array(list(SENSORS_MM.values()))[:, None]
    short, long = (
        resolve(change_scene(scene_of(influence=loads_csv(25)), measured={"length_mm": length_mm}))
        for length_mm in (300, 30_000)
    )
    told, wanted = (surface.influence.at(sensors_mm, between) for surface in (long, short))
    assert np.allclose(told, wanted, rtol=1e-3)


def test_an_uplifted_sensor_loses_its_reading_and_not_the_place() -> None:
    """At two places, one sensor shows what is beyond its characteristic; the others tell what they show there."""
    table = recorded_loads(np.linspace(15, 285, 24), [3.0, 6.0, 12.0, 20.0], optical)
    head, *rows = table.splitlines()
    uplifted = [
        ",".join([*(cells := row.split(","))[:4], "2000,-3,good", *cells[7:]])
        if 130 < float(row.split(",")[2]) < 160
        else row
        for row in rows
    ]
    sensors = {"range_mm": [1, 19]}
    whole, holed = (
        measured_structure_of(change_scene(scene_of(influence=text, curved=True), sensors=sensors))
        for text in (table, "\n".join([head, *uplifted]))
    )
    places = np.array([145.0])
    told, wanted = (one.influence(one.sensor_mm, places)[0] for one in (holed, whole))
    unknown, known = (one.deviation(one.sensor_mm[:, None], places[:, None])[0] for one in (holed, whole))
    assert np.allclose(told[1:], wanted[1:], rtol=0.01)
    assert np.all(unknown[1:] < 1.3 * known[1:])
    assert unknown[0] > 2 * known[0]


@pytest.mark.soak
def test_sensors_that_saturate_are_known_less_well_under_heavy_loads() -> None:
    def saturating(deflection_mm: Floats) -> Floats:
        return 1.2 * (1 - np.exp(-deflection_mm / 1.2))

    table = recorded_loads(np.linspace(15, 285, 24), [3.0, 6.0, 12.0, 20.0], saturating)
    surface = resolve(change_scene(scene_of(influence=table, curved=True), sensors={"range_mm": [1, 19]}))
    model = surface.place().build("leaf", effort=EFFORT)
    rng = np.random.default_rng(4)
    place_mm, force_n = rng.uniform(20, 280, 600), rng.uniform(3, 20, 600)
    straight_mm = force_n[:, None] * influence(model.metadata.layout_mm, place_mm)
    shown = model.straighten(saturating(straight_mm) + 0.004 / np.sqrt(5) * rng.normal(size=straight_mm.shape))
    answers = model.estimate(shown.deflection_mm)
    held = (answers["position_low_mm"] <= place_mm) & (place_mm <= answers["position_high_mm"])
    assert held[answers["state"] == "contact"].mean() > 0.93


def test_a_contact_at_the_very_end_is_held_as_often_as_others() -> None:
    model = resolve(scene_of(influence=loads_csv(50))).place().build("leaf", effort=EFFORT)
    rng, noise_mm = np.random.default_rng(6), 0.1 * model.metadata.noise.sample_mm
    for place_mm in (15.0, 285.0):
        force_n = rng.uniform(5, 20, 500)
        deflection_mm = force_n[:, None] * influence(model.metadata.layout_mm, np.array([place_mm]))
        deflection_mm = deflection_mm + noise_mm * rng.normal(size=deflection_mm.shape)
        answers = model.estimate(deflection_mm, noise_mm=noise_mm)
        held = (answers["position_low_mm"] <= place_mm) & (place_mm <= answers["position_high_mm"])
        assert held.mean() > 0.93, place_mm


def test_the_identity_has_all_that_decides_what_sensors_show() -> None:
    table = recorded_loads(np.linspace(15, 285, 24), [3.0, 12.0], as_they_are)

    def identity(curved: bool, **changes: dict[str, float]) -> str:
        return identity_of(change_scene(scene_of(influence=table, curved=curved), **changes), SENSORS_MM)

    assert identity(False) == identity(False, sensors={"noise_mm": 0.01})
    assert identity(True) != identity(True, sensors={"noise_mm": 0.01})
    assert identity(False) != identity(False, measured={"length_mm": 301})


def test_a_simulated_structure_is_one_that_the_table_allows() -> None:
    """Rig and challenge play it: a model that trusts its table too much shows there."""
    surface = resolve(scene_of(influence=loads_csv(16)))
    world, rng = surface.layout(list(SENSORS_MM.values())).world, np.random.default_rng(8)
    places = np.linspace(24, 276, 9)
    drawn = np.array([world.draw(rng).under(places, 1.0) for _ in range(60)])
    wanted = surface.influence.interpolation
    assert wanted is not None
    deviation = wanted.deviation_at(world.sensor_mm[:, None], places[:, None])
    assert np.all(np.abs(drawn.std(axis=0) / deviation - 1) < 0.5)
    assert abs(np.log((drawn.std(axis=0) / deviation).mean())) < 0.1
    assert np.abs((drawn.mean(axis=0) - world.under(places, 1.0)) / deviation).max() < 0.6


def test_a_simulated_beam_is_as_its_scene() -> None:
    world = resolve(parse_scene(PAPER, "the scene")).layout([130, 270]).world
    assert world.draw(np.random.default_rng(1)) is world
