"""Tables of a measured structure that are refused or doubted, each in one line that says what to do."""

from pathlib import Path

import pytest

from beamtouch_models import change_scene, make_scene, resolve
from beamtouch_models.design.building.remarks import remarks
from beamtouch_models.errors import InputError
from support.programs.in_process import Refusal
from support.surfaces.tapered_leaf import loads_csv, scene_of, write_scene

GOOD = loads_csv(16, repeats=0.0)
HEAD, *ROWS = GOOD.splitlines()


def table_of(*rows: str, head: str = HEAD) -> str:
    return "\n".join([head, *rows]) + "\n"


def with_place(row: str, place_mm: float) -> str:
    return ",".join([f"{place_mm:g}", *row.split(",")[1:]])


def times(row: str, place: float = 1.0, force: float = 1.0, deflection: float = 1.0) -> str:
    at, with_n, *shown = map(float, row.split(","))
    return ",".join(f"{value:.6g}" for value in (place * at, force * with_n, *(deflection * one for one in shown)))


BAD = {
    "sparse": (table_of(*ROWS[::4]), "loads more would do"),
    "one-sided": (table_of(*ROWS[:8]), "the loads are too far apart for contact.position_mm: at 2"),
    "one load": (table_of(ROWS[0]), "1 loads are fewer than 4"),
    "no loads": (table_of(), "it has no loads, only the names of columns"),
    "one place": (table_of(*(with_place(row, 150) for row in ROWS)), "all loads are at 1 of at least 3 places"),
    "contradiction": (
        table_of(*ROWS[:5], ",".join([*ROWS[5].split(",")[:2], *ROWS[12].split(",")[2:]]), *ROWS[6:]),
        "but the others say",
    ),
    "negative force": (
        table_of(
            *ROWS[:3], ROWS[3].replace(",5,", ",-5,").replace(",10,", ",-10,").replace(",20,", ",-20,"), *ROWS[4:]
        ),
        "pulls; state forces that press as positive",
    ),
    "no force": (
        table_of(f"{ROWS[0].split(',')[0]},0,0,0,0,0", *ROWS),
        "line 2: force_n = 0 is no load; take the row out",
    ),
    "before the left end": (table_of(with_place(ROWS[0], -15), *ROWS[1:]), "count places from the left end"),
    "nan": (
        table_of(*ROWS[:3], "90,10,nan,0.1,0.1,0.1", *ROWS[3:]),
        "line 5: left_deflection_mm is nan, which nobody measures",
    ),
    "huge": (
        table_of(*ROWS[:3], "90,10,1e30,0.1,0.1,0.1", *ROWS[3:]),
        "line 5: left_deflection_mm is 1e+30, which nobody measures",
    ),
    "text": (table_of(*ROWS[:3], "90 mm,10,0.1,0.1,0.1,0.1", *ROWS[3:]), "states '90 mm', which is not a number"),
    "dead sensor": (table_of(*(",".join([*row.split(",")[:-1], "0"]) for row in ROWS)), "right is 0 under all loads"),
    "unknown column": (
        table_of(*ROWS, head=HEAD.replace("right_deflection_mm", "right_um")),
        "column 'right_um' is not known",
    ),
    "copied column": (
        table_of(*(",".join([*row.split(",")[:-1], row.split(",")[2]]) for row in ROWS)),
        "left and right show the same under all loads, to the last digit",
    ),
    "in um, by its columns": (
        table_of(*ROWS, head=HEAD.replace("deflection_mm", "deflection_um")),
        "column left_deflection_um: lengths are in mm; convert it, one um is 0.001 mm",
    ),
    "in um, by its size": (
        table_of(*(times(row, deflection=1000.0) for row in ROWS)),
        "more than the structure is long; if the table is in um, divide its deflections by 1000",
    ),
    "forces in g, by its columns": (
        table_of(*ROWS, head=HEAD.replace("force_n", "force_g")),
        "column force_n is missing; convert force_g: one g weighs 0.00981 N",
    ),
    "places in m, by its columns": (
        table_of(*ROWS, head=HEAD.replace("position_mm", "position_m")),
        "column position_mm is missing; convert position_m: one um is 0.001 mm, one m 1000 mm",
    ),
    "two units": (
        table_of(*ROWS, head=HEAD.replace("right_deflection_mm", "right_deflection_V")),
        "outer is in mm and right in V",
    ),
    "no place": (table_of(*ROWS, head=HEAD.replace("position_mm", "place")), "column position_mm is missing"),
    "no sensor": (table_of("15,10", head="position_mm,force_n"), "it has no column of a sensor"),
}


@pytest.mark.parametrize("name", BAD)
def test_a_bad_table_is_refused_in_one_line_that_says_what_to_do(name: str, tmp_path: Path, refused: Refusal) -> None:
    table, wanted = BAD[name]
    scene = write_scene(tmp_path, GOOD)
    (tmp_path / "leaf.csv").write_text(table)
    line = refused("build", scene, "-o", tmp_path / "leaf.onnx")
    assert wanted in line
    assert not (tmp_path / "leaf.onnx").exists()


DOUBTFUL = {
    "forces in g": (
        table_of(*(times(row, force=102.0, deflection=1.0) for row in ROWS)),
        "if the loads are in g, 100 g weigh 0.981 N",
    ),
    "deflections in m": (
        table_of(*(times(row, deflection=0.001) for row in ROWS)),
        "if the table is in m, multiply its deflections by 1000",
    ),
    "negative": (
        table_of(*(times(row, deflection=-1.0) for row in ROWS)),
        "if it comes nearer to the sensors, change the signs",
    ),
    "copied rows": (table_of(*ROWS, ROWS[3]), "are equal to the last digit, as copied rows are"),
}


@pytest.mark.parametrize("name", DOUBTFUL)
def test_a_table_that_may_be_right_is_doubted_in_one_line(name: str) -> None:
    table, wanted = DOUBTFUL[name]
    remark, *others = remarks(scene_of(influence=table))
    assert wanted in remark
    assert not others


def test_places_in_metres_are_told_from_a_short_structure() -> None:
    table = table_of(*(times(row, place=0.001) for row in ROWS))
    with pytest.raises(InputError, match=r"if the places of its loads are in metres, write 285"):
        make_scene(
            measured={"influence": table},
            contact={"force_n": [2, 20], "position_mm": [0.015, 0.285]},
            sensors={"noise_mm": 0.004, "rate_hz": 100, "range_mm": [1, 9]},
        )


@pytest.mark.promise("docs/reference/loads.md", "Further columns are yours")
def test_a_table_may_have_columns_of_its_owner() -> None:
    rows = [f"{row},kitchen scale" for row in ROWS]
    with_more = scene_of(influence=table_of(*rows, head=f"{HEAD},remark"))
    assert with_more == scene_of(influence=GOOD)


def test_a_table_that_is_missing_is_refused(tmp_path: Path, refused: Refusal) -> None:
    scene = write_scene(tmp_path, GOOD)
    (tmp_path / "leaf.csv").unlink()
    assert "leaf.csv: No such file or directory; give the path of a CSV file, relative to the scene" in refused(
        "explain", scene
    )


@pytest.mark.parametrize(
    ("tables", "wanted"),
    [
        ({"sensors": {"count": 5}}, "sensors.count = 5, but the table has 4 sensors"),
        ({"sensors": {"fixed_mm": [100]}}, "sensors.fixed_mm has 100 mm, where the table has no sensor"),
        ({"sensors": {"mounting_tolerance_mm": 1}}, "sensors stand where they were measured"),
        ({"contact": {"width_mm": 5}}, "contact.width_mm is for a beam"),
        ({"contact": {"position_mm": [15, 400]}}, "reaches beyond the structure, 0..300 mm"),
        ({"measured": {"sensors_mm": {"left": 45}}}, "sensors_mm lacks inner"),
        ({"measured": {"length_mm": 200}}, "is beyond it"),
        ({"beam": {"length_mm": 300, "flexural_rigidity_n_mm2": 1e6}}, "state either beam or measured, not both"),
    ],
)
def test_what_contradicts_a_table_is_refused(tables: dict[str, dict[str, object]], wanted: str) -> None:
    scene = scene_of(influence=GOOD)
    if "sensors_mm" in tables.get("measured", {}):
        scene = change_scene(scene, measured={"sensors_mm": None})
    with pytest.raises(InputError, match=wanted):
        change_scene(scene, **tables)


def test_a_sensor_that_shows_a_single_load_is_named() -> None:
    head, *rows = loads_csv(25).splitlines()
    quiet = [",".join([*row.split(",")[:-1], "0"]) for row in rows[1:]]
    with pytest.raises(InputError, match="right shows 0 under all loads but one; check it, or take it out"):
        resolve(scene_of(influence="\n".join([head, rows[0], *quiet])))


def test_more_sensors_than_were_measured_are_refused() -> None:
    with pytest.raises(InputError, match="5 sensors do not fit on 4 places"):
        resolve(scene_of(influence=GOOD)).place(5)


def test_sensors_that_all_scatter_are_not_to_be_taken_out() -> None:
    head, *rows = loads_csv(24, repeats=0.6).splitlines()
    with pytest.raises(InputError, match="all sensors repeat to"):
        resolve(scene_of(influence="\n".join([head, *rows])))


def test_loads_without_repeated_samples_do_not_tell_their_noise(tmp_path: Path, refused: Refusal) -> None:
    (tmp_path / "leaf.csv").write_text(GOOD)
    line = refused("build", "--loads", tmp_path / "leaf.csv", "-o", tmp_path / "leaf.onnx")
    assert "no load has 5 samples that differ, which tell the noise" in line


def test_doubts_state_the_numbers_that_raise_them() -> None:
    """Of loads of 10 N, the leaf moves by so many mm under the 20 N of its contacts."""
    shown = [[float(value) for value in row.split(",")] for row in ROWS]
    bent_mm = max(value / row[1] for row in shown for value in row[2:]) * 20
    (small,) = remarks(scene_of(influence=table_of(*(times(row, deflection=1e-3) for row in ROWS))))
    assert small.startswith(f"by its table, the structure bends by {bent_mm:.3g} um only; if the table is in m")
    (grams,) = remarks(scene_of(influence=table_of(*(times(row, force=102.0) for row in ROWS))))
    weakest, strongest = (
        f"{102 * force:.4g}" for force in (min(row[1] for row in shown), max(row[1] for row in shown))
    )
    assert f"the loads of the table have {weakest} to {strongest} N, but contact.force_n is 2 to 20 N; " in grams
    (copied,) = remarks(scene_of(influence=table_of(*ROWS, ROWS[3], ROWS[3])))
    assert copied.startswith(f"3 loads at {shown[3][0]:g} mm with {shown[3][1]:g} N are equal to the last digit")
