"""Structures of two axes whose influence was measured: models of skins, and tables that are refused."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from beamtouch_models import Model, change_scene, load_model, resolve
from beamtouch_models.design.building.build import build_model
from beamtouch_models.design.building.remarks import remarks
from beamtouch_models.design.building.report.facts import gather
from beamtouch_models.design.building.report.page import page
from beamtouch_models.design.building.report.parts import parts_of
from beamtouch_models.design.effort import Effort
from beamtouch_models.design.physics.measured_structure import measured_structure_of
from beamtouch_models.errors import InputError, SceneError
from beamtouch_models.lab.rig.surface import Imperfections, VirtualSurface
from support.programs.in_process import Command, Refusal
from support.surfaces.magnet_skin import (
    NOISE_UT,
    SENSORS_MM,
    SIZE_MM,
    grid,
    influence,
    loads_csv,
    scene_of,
    write_scene,
)

GRID = grid(9, 7)
GOOD = loads_csv(GRID)
HEAD, *ROWS = GOOD.splitlines()


@pytest.fixture(scope="module")
def model() -> Model:
    return resolve(scene_of(GOOD)).place().build("skin", effort=0.01)


def test_contacts_on_a_skin_are_found_between_its_loads(model: Model) -> None:
    rng = np.random.default_rng(1)
    place_mm, force_n = rng.uniform([5, 5], [SIZE_MM[0] - 5, SIZE_MM[1] - 5], (400, 2)), rng.uniform(2, 8, 400)
    shown = force_n[:, None] * influence(place_mm)[:, [list(SENSORS_MM).index(name) for name in model.channels]]
    assert shown.min() < -50
    answers = model.estimate(shown + NOISE_UT / np.sqrt(5) * rng.normal(size=shown.shape))
    is_contact = answers["state"] == "contact"
    assert is_contact.mean() > 0.95
    off_mm = []
    for axis, name in enumerate("xy"):
        true_mm = place_mm[:, axis]
        held = (answers[f"{name}_low_mm"] <= true_mm) & (true_mm <= answers[f"{name}_high_mm"])
        assert held[is_contact].mean() > 0.9
        off_mm.append((answers[f"{name}_mm"] - true_mm)[is_contact])
    assert np.hypot(*off_mm).mean() < 0.01 * np.hypot(*SIZE_MM)
    assert {channel.unit for channel in model.metadata.layout} == {"uT"}


@pytest.mark.promise("docs/how-to/measured.md", "a column for each axis, `x_mm` and `y_mm`")
def test_a_model_of_a_skin_holds_its_table(tmp_path: Path, design_sensors_roughly: Command, model: Model) -> None:
    scene = write_scene(tmp_path, GOOD)
    told = design_sensors_roughly("explain", scene)
    assert told.returncode == 0, told.stderr
    assert "of a table of places" in " ".join(told.stdout.split())
    model.save(tmp_path / "skin.onnx")
    stored = load_model(tmp_path / "skin.onnx")
    assert stored.metadata.scene.count("\n") > len(ROWS)
    assert set(stored.channels) == set(SENSORS_MM)


def test_a_report_gives_no_tolerance_for_sensors_that_stay_where_they_were_measured(model: Model) -> None:
    parts = {part.name: part for part in parts_of(resolve(scene_of(GOOD)), model.metadata)}
    assert "mounting" not in parts
    assert parts["value at rest"].value == "0 uT"


@pytest.mark.soak
def test_a_report_of_a_skin_has_pictures_from_above_and_no_beam() -> None:
    layout = resolve(scene_of(GOOD)).place()
    built = build_model(replace(layout, aim=replace(layout.aim, effort=Effort(0.01))), "skin")
    text = page(gather(built, lambda _doing, _done: None))
    assert "beam" not in re.sub(r"(?i)beamtouch", "", text)
    assert "60 x 40 mm" in text
    assert "The value at rest is 0 uT, and a sensor shows at most" in text
    assert "Its supports are not known, as its influence was measured" in text
    (drawing, *_) = re.findall(r"<svg.*?</svg>", text, re.DOTALL)
    assert drawing.count('class="sensor') == len(SENSORS_MM)


@pytest.mark.soak
def test_a_skin_is_challenged(tmp_path: Path, design_sensors_roughly: Command, model: Model) -> None:
    model.save(tmp_path / "skin.onnx")
    done = design_sensors_roughly("challenge", tmp_path / "skin.onnx", "--draws", "10", "--json")
    assert done.returncode == 0, done.stderr
    assert any(row["error_mm"] for row in json.loads(done.stdout)["rows"] if row["honest"])


@pytest.mark.parametrize(
    ("moved", "wanted"),
    [
        (Imperfections(x_offset_mm=(1.0, 0.0, 0.0, 0.0)), "x_offset_mm is for a plate"),
        (Imperfections(position_offset_mm=(1.0, 0.0, 0.0, 0.0)), "stay; leave it out"),
    ],
)
def test_sensors_of_a_skin_stay_where_they_were_measured(moved: Imperfections, wanted: str, model: Model) -> None:
    with pytest.raises(SceneError, match=wanted):
        VirtualSurface(scene_of(GOOD), model.metadata, 0, moved)


@pytest.mark.soak
def test_three_of_four_sensors_are_chosen(tmp_path: Path, design_sensors_roughly: Command) -> None:
    placed = design_sensors_roughly("place", write_scene(tmp_path, GOOD), "--sensors", "3")
    assert placed.returncode == 0, placed.stderr
    assert sum(name in placed.stdout for name in SENSORS_MM) >= 3


def recorded(places: int) -> str:
    """Return loads with eight samples each, as `beamtouch-daemon record` writes them."""
    rng, rows = np.random.default_rng(2), []
    columns = [f"{name}_{column}" for name in SENSORS_MM for column in ("counts", "deflection_uT", "quality")]
    for load, (x, y) in enumerate(GRID[:places], start=1):
        shown = 5 * influence(np.array([[x, y]]))[0]
        for sample in range(8):
            cells = [f"2000,{value:.6f},good" for value in shown + NOISE_UT * rng.normal(size=len(shown))]
            rows.append(",".join([f"{60 * load + sample / 100:.2f}", str(load), f"{x:g}", f"{y:g}", "5", *cells]))
    return "\n".join([",".join(["unix_time_s", "load", "x_mm", "y_mm", "force_n", *columns]), *rows]) + "\n"


@pytest.mark.soak
def test_loads_on_two_axes_alone_make_a_model(tmp_path: Path, design_sensors_roughly: Command) -> None:
    (tmp_path / "skin.csv").write_text(recorded(len(GRID)))
    done = design_sensors_roughly(
        "build", "--loads", tmp_path / "skin.csv", "-o", tmp_path / "skin.onnx", "--daemon-config", tmp_path / "d.toml"
    )
    assert done.returncode == 0, done.stderr
    assert "contacts at 3 to 57 by 3 to 37 mm with 1 to 5 N" in " ".join(done.stderr.split())
    assert "so each is drawn where it shows most: " in done.noted
    assert (tmp_path / "d.toml").read_text().count("y_mm") > len(SENSORS_MM)


SLOW = ("sparse",)
"""It is told where further loads would help, which takes seconds."""


def table_of(*rows: str, head: str = HEAD) -> str:
    return "\n".join([head, *rows]) + "\n"


def with_cell(row: str, column: int, cell: str) -> str:
    cells = row.split(",")
    return ",".join([*cells[:column], cell, *cells[column + 1 :]])


BAD = {
    "sparse": (loads_csv(grid(3, 3)[::2]), "the loads are too far apart for contact.x_mm and y_mm: at ("),
    "one-sided": (table_of(*ROWS[:21]), "the loads are too far apart for contact.x_mm and y_mm: at ("),
    "on one line": (loads_csv(np.linspace([5, 5], [55, 35], 20)), "all loads are on one line; spread them over both"),
    "along one axis": (table_of(*ROWS[:7]), "all loads are at 1 of at least 3 x_mm; spread them over the range"),
    "one load": (table_of(ROWS[0]), "1 loads are fewer than 4"),
    "no loads": (table_of(), "it has no loads, only the names of columns"),
    "contradiction": (
        table_of(*ROWS[:30], ",".join([*ROWS[30].split(",")[:3], *ROWS[40].split(",")[3:]]), *ROWS[31:]),
        "but the others say",
    ),
    "negative force": (table_of(with_cell(ROWS[0], 2, "-4"), *ROWS[1:]), "force_n = -4 pulls; state forces that press"),
    "no force": (table_of(with_cell(ROWS[0], 2, "0"), *ROWS[1:]), "line 2: force_n = 0 is no load; take the row out"),
    "below the corner": (
        table_of(with_cell(ROWS[0], 1, "-3"), *ROWS[1:]),
        "line 2: y_mm is -3; count places from the lower left corner",
    ),
    "nan": (table_of(with_cell(ROWS[3], 4, "nan"), *ROWS), "line 2: se_deflection_uT is nan, which nobody measures"),
    "huge": (table_of(with_cell(ROWS[3], 0, "1e30"), *ROWS), "line 2: x_mm is 1e+30, which nobody measures"),
    "zero": (table_of(*(with_cell(row, 6, "0") for row in ROWS)), "ne is 0 under all loads; check the sensor"),
    "no y": (table_of(*ROWS, head=HEAD.replace("y_mm", "across")), "column y_mm is missing"),
    "y in m": (table_of(*ROWS, head=HEAD.replace("y_mm", "y_m")), "column y_mm is missing; convert y_m: one um is"),
    "both": (table_of(*ROWS, head=HEAD.replace("y_mm", "position_mm")), "it has both position_mm and x_mm; state"),
}


@pytest.mark.parametrize("name", [pytest.param(name, marks=pytest.mark.soak) if name in SLOW else name for name in BAD])
def test_a_bad_table_of_two_axes_is_refused_in_one_line(name: str, tmp_path: Path, refused: Refusal) -> None:
    table, wanted = BAD[name]
    assert wanted in refused("build", write_scene(tmp_path, table), "-o", tmp_path / "skin.onnx")
    assert not (tmp_path / "skin.onnx").exists()


@pytest.mark.soak
@pytest.mark.promise("docs/how-to/measured.md", "it names up to 20 such loads at once")
def test_loads_that_contradict_the_others_are_named_together_and_no_others(tmp_path: Path, refused: Refusal) -> None:
    head, *good = loads_csv(grid(7, 5)).splitlines()
    rows = list(good)
    for wrong, shown_at in ((17, 27), (8, 30)):
        rows[wrong] = ",".join([*good[wrong].split(",")[:3], *good[shown_at].split(",")[3:]])
    line = refused("build", write_scene(tmp_path, table_of(*rows, head=head)), "-o", tmp_path / "skin.onnx")
    for wrong in (17, 8):
        x, y, force, *_ = good[wrong].split(",")
        assert f"under the load at ({x}, {y}) mm with {force} N, " in line
    assert line.count("but the others say") == 2
    assert line.rstrip().endswith("measure each of these loads again, or take them out")


def test_repeated_loads_count_as_what_they_tell_and_copies_are_doubted() -> None:
    twice = loads_csv(np.repeat(GRID, 2, axis=0), repeats=0.02)
    once, both = (measured_structure_of(scene_of(table)) for table in (GOOD, twice))
    assert np.all(both.repeatability > 2 * once.repeatability)
    (doubt,) = remarks(scene_of(table_of(*ROWS, ROWS[3])))
    assert "loads at (3, 20) mm with" in doubt
    assert "are equal to the last digit, as copied rows are" in doubt


@pytest.mark.parametrize(
    ("tables", "wanted"),
    [
        ({"contact": {"x_mm": None, "y_mm": None, "position_mm": [5, 55]}}, "the table of the structure has x_mm and"),
        ({"contact": {"y_mm": [3, 45]}}, r"contact.y_mm = \[3.0, 45.0\] reaches beyond the structure, 0..40 mm"),
        ({"measured": {"length_mm": 60}}, "length_mm is not of the axes of the table; state length_x_mm and"),
        ({"measured": {"length_x_mm": 20}}, r"length_x_mm = 20, but the load at \(23.25, 3\) mm is beyond it"),
        ({"measured": {"sensors_mm": dict.fromkeys(SENSORS_MM, 20)}}, "sensors_mm: nw has not the axes of the table"),
        ({"sensors": {"fixed": [{"x_mm": 1, "y_mm": 2}]}}, r"sensors.fixed has \(1, 2\) mm, where the table has no"),
        ({"sensors": {"keep_out": [{"x_mm": [1, 2], "y_mm": [1, 2]}]}}, "sensors stand where they were measured"),
        ({"contact": {"width_mm": 5}}, "contact.width_mm is for a beam or a plate"),
    ],
)
def test_what_contradicts_a_table_of_two_axes_is_refused(tables: dict[str, dict[str, object]], wanted: str) -> None:
    with pytest.raises(InputError, match=wanted):
        change_scene(scene_of(GOOD), **tables)


@pytest.mark.soak
def test_a_structure_that_is_simulated_is_one_that_the_table_of_two_axes_allows() -> None:
    structure, rng = measured_structure_of(scene_of(loads_csv(grid(6, 5)))), np.random.default_rng(8)
    places = rng.uniform([5, 5], [55, 35], (12, 2))
    drawn = np.array([structure.draw(rng).influence(structure.sensor_mm, places) for _ in range(40)])
    deviation = structure.deviation(structure.sensor_mm, places)
    assert abs(np.log((drawn.std(axis=0) / deviation).mean())) < 0.2


def test_more_places_than_are_searched_at_once_are_fitted_as_their_influence_is() -> None:
    structure = measured_structure_of(scene_of(loads_csv(grid(21, 16))))
    places = np.random.default_rng(3).uniform([5, 5], [55, 35], (50, 2))
    told = structure.influence(np.array(list(SENSORS_MM.values())), places)
    assert np.abs(told - influence(places)).max() < 0.02 * np.abs(told).max()


@pytest.mark.soak
def test_gains_of_a_measured_skin_are_calibrated(tmp_path: Path, design_sensors_roughly: Command, model: Model) -> None:
    model.save(tmp_path / "skin.onnx")
    gain, rng = {"nw": 1.06, "se": 0.95, "sw": 1.0, "ne": 1.0}, np.random.default_rng(3)
    rows = ["load,x_mm,y_mm,force_n," + ",".join(f"{name}_deflection_uT" for name in SENSORS_MM)]
    for load, (x, y) in enumerate(grid(4, 3), start=1):
        shown = 5 * influence(np.array([[x, y]]))[0] * np.array([gain[name] for name in SENSORS_MM])
        rows += [
            f"{load},{x:g},{y:g},5," + ",".join(f"{value:.5f}" for value in shown + NOISE_UT * rng.normal(size=4))
            for _ in range(6)
        ]
    (tmp_path / "loads.csv").write_text("\n".join(rows))
    done = design_sensors_roughly(
        "calibrate", tmp_path / "skin.onnx", tmp_path / "loads.csv", "-o", tmp_path / "calibrated.onnx"
    )
    assert done.returncode == 0, done.stderr
    after = load_model(tmp_path / "calibrated.onnx").metadata
    departures = after.departures
    wanted = np.array([gain[channel.name] for channel in after.layout])
    assert np.abs(np.array(departures.gain) / departures.rigidity - wanted).max() < 0.015
