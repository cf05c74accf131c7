"""What a scene states beside a table of loads is taken up to each limit, and refused beyond it by the reason."""

from pathlib import Path
from typing import Any

import pytest

from beamtouch_models import make_scene
from beamtouch_models.design.scene import Scene
from beamtouch_models.errors import InputError
from models.load_tables import HEAD, PLANE, PLANE_ROWS, ROWS, table

MEASURED = {"influence": table()}
SKIN = {"influence": table(PLANE_ROWS, PLANE)}


def scene_of(measured: dict[str, Any], *changes: tuple[str, str, object]) -> Scene:
    is_skin = measured["influence"] == SKIN["influence"]
    tables: dict[str, dict[str, Any]] = {
        "measured": dict(measured),
        "contact": {
            "force_n": [2, 8],
            **({"x_mm": [10, 250], "y_mm": [5, 90]} if is_skin else {"position_mm": [10, 250]}),
        },
        "sensors": {"noise_mm": 0.01, "range_mm": [2, 7]},
    }
    for name, key, value in changes:
        tables[name][key] = value
        if value is None:
            del tables[name][key]
    return make_scene(**tables)


THEORY = table([(0, 1, 2), (100, 2, 3), (200, 3, 5), (250, 3, 1)], "position_mm,a_mm_per_n,b_mm_per_n")
MOVED = "sensors stand where they were measured; leave it out"
TWICE = "cannot share a position"
BESIDE: dict[str, tuple[dict[str, str], tuple[tuple[str, str, object], ...], str]] = {
    "contacts from": (
        MEASURED,
        (("contact", "position_mm", [-1, 250]),),
        "contact.position_mm = [-1.0, 250.0] reaches beyond the structure, 0..250 mm; correct it, or state "
        "measured.length_mm",
    ),
    "contacts to": (
        SKIN,
        (("contact", "y_mm", [5, 91]),),
        "contact.y_mm = [5.0, 91.0] reaches beyond the structure, 0..90 mm; correct it, or state measured.length_y_mm",
    ),
    "tolerance": (
        MEASURED,
        (("sensors", "mounting_tolerance_mm", 1),),
        f"sensors.mounting_tolerance_mm is for a beam or a plate; {MOVED}",
    ),
    "distance": (
        MEASURED,
        (("sensors", "min_distance_mm", 1),),
        f"sensors.min_distance_mm is for a beam or a plate; {MOVED}",
    ),
    "keep-out": (
        MEASURED,
        (("sensors", "keep_out_mm", [[1, 2]]),),
        f"sensors.keep_out_mm is for a beam or a plate; {MOVED}",
    ),
    "keep-out of two axes": (
        SKIN,
        (("sensors", "keep_out", [{"x_mm": [1, 2], "y_mm": [1, 2]}]),),
        f"sensors.keep_out is for a beam or a plate; {MOVED}",
    ),
    "width": (
        MEASURED,
        (("contact", "width_mm", 1),),
        "contact.width_mm is for a beam or a plate; a measured structure is as its loads pressed on it; leave it out",
    ),
    "elsewhere": (
        MEASURED,
        (("measured", "sensors_mm", {"a": 130, "b": 200}), ("sensors", "fixed_mm", [130, 201])),
        "sensors.fixed_mm has 201 mm, where the table has no sensor; its sensors are a at 130 mm, b at 200 mm",
    ),
    "elsewhere on two axes": (
        SKIN,
        (("sensors", "fixed", [{"x_mm": 3, "y_mm": 4}]),),
        "sensors.fixed has (3, 4) mm, where the table has no sensor; its sensors are a at (130, 5) mm, b at "
        "(60, 90) mm",
    ),
    "count": (
        MEASURED,
        (("sensors", "count", 3),),
        "sensors.count = 3, but the table has 2 sensors: a, b",
    ),
    "range": (
        {"influence": table(head=HEAD.replace("deflection_mm", "deflection_V"))},
        (("sensors", "range_mm", None),),
        "sensors.range_mm is missing: state the smallest and the largest value in V that the sensors show, as their "
        "data sheet or the input of their module has them",
    ),
    "in um": (
        {"influence": table([(place, force, 100 * a, 6000 * b) for place, force, a, b in ROWS])},
        (),
        "measured.influence: b shows 3360 mm under 8 N, more than the structure is long; if the table is in um, divide "
        "its deflections by 1000; if they are in another unit, name it, as b_deflection_uV/V",
    ),
    "in metres": (
        {"influence": table([(float(row[0]) / 1000, *row[1:]) for row in ROWS])},
        (("contact", "position_mm", [0.01, 0.25]),),
        "measured: the structure ends at 0.25 mm, too short to tell places on it; if the places of its loads are in "
        "metres, write 250",
    ),
    "axes of contacts": (
        MEASURED,
        (("contact", "position_mm", None), ("contact", "x_mm", [1, 2]), ("contact", "y_mm", [1, 2])),
        "contact has x_mm and y_mm, but the table of the structure has position_mm; state position_mm there",
    ),
    "axis of contacts": (
        SKIN,
        (("contact", "position_mm", [1, 2]), ("contact", "x_mm", None), ("contact", "y_mm", None)),
        "contact has position_mm, but the table of the structure has x_mm and y_mm; state x_mm and y_mm there",
    ),
    "unknown sensor": (
        MEASURED,
        (("measured", "sensors_mm", {"a": 1, "c": 2}),),
        "measured: sensors_mm names c, but the table has a, b",
    ),
    "missing sensor": (
        MEASURED,
        (("measured", "sensors_mm", {"a": 1}),),
        "measured: sensors_mm lacks b; state all, or none",
    ),
    "curved influence": (
        {"influence": THEORY},
        (("measured", "curved", True),),
        "measured: curved needs a table of loads, as one of influence has no forces; or leave it out",
    ),
    "theory of two axes": (
        SKIN,
        (("measured", "theory", THEORY),),
        "measured: theory is for structures of one axis; leave it out, and measure more loads",
    ),
    "theory of forces": (
        MEASURED,
        (("measured", "theory", table()),),
        "measured: theory has forces; it is a table of influence, with the columns position_mm, NAME_mm_per_n",
    ),
    "theory of others": (
        MEASURED,
        (("measured", "theory", THEORY.replace("b_mm", "c_mm")),),
        "measured: theory has no column b_mm_per_n; add it, or take b out of the loads",
    ),
    "short theory": (
        MEASURED,
        (("measured", "theory", THEORY.replace("250,", "249,")),),
        "measured: theory goes from 0 to 249 mm, but the table has a load at 250 mm; compute it there, too",
    ),
    "late theory": (
        MEASURED,
        (("measured", "theory", THEORY.replace("\n0,", "\n11,")),),
        "measured: theory goes from 11 to 250 mm, but the table has a load at 10 mm; compute it there, too",
    ),
    "length of two axes": (
        MEASURED,
        (("measured", "length_y_mm", 300),),
        "measured: length_y_mm is not of the axes of the table; state length_mm",
    ),
    "length of one axis": (
        SKIN,
        (("measured", "length_mm", 300),),
        "measured: length_mm is not of the axes of the table; state length_x_mm and length_y_mm",
    ),
    "sensors of two axes": (
        MEASURED,
        (("measured", "sensors_mm", {"a": 1, "b": {"x_mm": 3, "y_mm": 4}}),),
        "measured: sensors_mm: b has not the axes of the table; write b = 120",
    ),
    "sensors of one axis": (
        SKIN,
        (("measured", "sensors_mm", {"a": 1, "b": {"x_mm": 3, "y_mm": 4}}),),
        "measured: sensors_mm: a has not the axes of the table; write a = { x_mm = 20, y_mm = 30 }",
    ),
    "one place": (
        MEASURED,
        (("measured", "sensors_mm", {"a": 30, "b": 30}),),
        f"measured: sensors_mm has 30 mm twice; two sensors, a and b, {TWICE}",
    ),
    "one place of two axes": (
        SKIN,
        (("measured", "sensors_mm", {"a": {"x_mm": 3, "y_mm": 4}, "b": {"x_mm": 3, "y_mm": 4}}),),
        f"measured: sensors_mm has (3, 4) mm twice; two sensors, a and b, {TWICE}; of one chip, state them a little "
        "apart",
    ),
    "negative": (
        MEASURED,
        (("measured", "sensors_mm", {"a": 30, "b": -1}),),
        "measured: sensors_mm: b stands at -1 mm; count from the left end",
    ),
    "negative of two axes": (
        SKIN,
        (("measured", "sensors_mm", {"a": {"x_mm": 3, "y_mm": -4}, "b": {"x_mm": 3, "y_mm": 4}}),),
        "measured: sensors_mm: a stands at (3, -4) mm; count from the lower left corner",
    ),
    "load beyond the end": (
        MEASURED,
        (("measured", "length_mm", 249), ("measured", "sensors_mm", {"a": 30, "b": 261})),
        "measured: length_mm = 249, but the load at 250 mm is beyond it; correct one of them",
    ),
    "sensor beyond the end": (
        MEASURED,
        (("measured", "length_mm", 260), ("measured", "sensors_mm", {"a": 30, "b": 261})),
        "measured: length_mm = 260, but b at 261 mm is beyond it; correct one of them",
    ),
    "sensor beyond the edge": (
        SKIN,
        (
            ("measured", "length_y_mm", 90),
            ("measured", "sensors_mm", {"a": {"x_mm": 3, "y_mm": 91}, "b": {"x_mm": 3, "y_mm": 4}}),
        ),
        "measured: length_y_mm = 90, but a at (3, 91) mm is beyond it; correct one of them",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", BESIDE)
def test_what_a_table_contradicts_is_refused_by_its_reason(name: str) -> None:
    measured, changes, said = BESIDE[name]
    with pytest.raises(InputError) as refused:
        scene_of(measured, *changes)
    assert str(refused.value) == f"the scene: {said}"


ALLOWED: dict[str, tuple[dict[str, str], tuple[tuple[str, str, object], ...]]] = {
    "contacts everywhere": (MEASURED, (("contact", "position_mm", [0, 250]),)),
    "its own end": (MEASURED, (("measured", "length_mm", 250), ("measured", "sensors_mm", {"a": 0, "b": 250}))),
    "as many sensors": (MEASURED, (("sensors", "count", 2),)),
    "fixed": (MEASURED, (("sensors", "fixed_mm", [130]),)),
    "fixed on two axes": (SKIN, (("sensors", "fixed", [{"x_mm": 60, "y_mm": 90}]),)),
    "a theory of just these loads": (MEASURED, (("measured", "theory", THEORY.replace("\n0,", "\n10,")),)),
    "deflections of its length": ({"influence": table([(*row[:3], 250 * float(row[1]) / 8 * share) for row, share in zip(ROWS, (0.1, 0.5, 0.8, 1), strict=True)])}, ()),  # noqa: E501
}  # fmt: skip


@pytest.mark.parametrize("name", ALLOWED)
def test_what_fits_a_table_is_taken(name: str) -> None:
    measured, changes = ALLOWED[name]
    scene_of(measured, *changes)


def test_a_table_that_is_no_table_by_its_size_is_refused_before_it_is_read(tmp_path: Path) -> None:
    path = tmp_path / "loads.csv"
    with path.open("wb") as file:
        file.truncate((64 << 20) + 1)
    with pytest.raises(InputError, match=r"loads\.csv: larger than 64 MiB; is it the right file\?"):
        scene_of({"influence": str(path)})
    path.write_text(table())
    scene = scene_of({"influence": str(path)})
    assert scene == scene_of(MEASURED)
    assert scene.measured is not None
    assert not scene.measured.curved


def test_a_structure_ends_with_its_last_load_or_sensor_unless_it_says_where() -> None:
    for changes, size_mm in (
        ((), (250,)),
        ((("measured", "sensors_mm", {"a": 30, "b": 270}),), (270,)),
        ((("measured", "length_mm", 300),), (300,)),
    ):
        scene = scene_of(MEASURED, *changes)
        assert (scene.size_mm, scene.length_mm, scene.diagonal_mm) == (size_mm, size_mm[0], size_mm[0])
    skin = scene_of(SKIN, ("measured", "length_x_mm", 400))
    assert (skin.size_mm, skin.diagonal_mm, skin.has_two_axes) == ((400, 90), 410, True)
    assert (skin.is_computed, skin.has_beam) == (False, False)


def test_sensors_that_show_most_at_one_place_are_drawn_beside_each_other_towards_the_middle() -> None:
    rows = [(10, 5, 0.3, 0.3, 0.1), (60, 5, 0.2, 0.1, -0.2), (130, 5, 0.1, 0.1, 0.15), (250, 5, 0.1, 0.2, 0.2)]
    head = f"{HEAD},c_deflection_mm"
    measured = scene_of({"influence": table(rows, head)}).measured
    assert measured is not None
    assert measured.places_mm == pytest.approx({"a": 10, "b": 12.5, "c": 60})
    mirrored = [(260 - float(row[0]), *row[1:]) for row in rows]
    measured = scene_of({"influence": table(mirrored, head)}).measured
    assert measured is not None
    assert measured.places_mm == pytest.approx({"a": 250, "b": 247.5, "c": 200})


def test_a_scene_has_as_many_sensors_as_its_table_unless_it_says_otherwise() -> None:
    for changes, counts in (
        ((), (2, 2)),
        ((("sensors", "count", 1),), (1, 1)),
        ((("sensors", "count", [1, 9]),), (1, 2)),
    ):
        assert scene_of(MEASURED, *changes).count_range == counts
    with_error = make_scene(
        measured={"influence": table([(*row, 0.01 * float(row[0])) for row in ROWS], f"{HEAD},c_deflection_mm")},
        contact={"force_n": 2, "position_mm": [10, 250]},
        sensors={"noise_mm": 0.01, "range_mm": [2, 7]},
        requirements={"position_error_mm": 5},
    )
    assert with_error.count_range == (2, 3)
