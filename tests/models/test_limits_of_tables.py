"""Tables of loads are taken up to each limit, and refused beyond it by the reason."""

import numpy as np
import pytest

from beamtouch_models.design.rows import RecordingError, parse_rows
from beamtouch_models.design.scene.measured_loads import MeasuredLoads, parse_loads, rows_of_loads
from models.load_tables import HEAD, PLANE, PLANE_ROWS, ROWS, Rows, changed, even, table


def read(rows: Rows = ROWS, head: str = HEAD) -> MeasuredLoads:
    return parse_loads(table(rows, head), "loads.csv")


LINES = [(10, 20), (60, 45), (130, 80), (250, 140)]
"""On the line y = x / 2 + 15."""
OF_LOADS = (
    "the columns of loads are position_mm (or x_mm and y_mm), force_n and NAME_deflection_mm, those of influence "
    "position_mm (or x_mm and y_mm) and NAME_mm_per_n; another unit takes the place of mm in them, as in "
    "NAME_deflection_uV/V"
)
OF_PLANES = OF_LOADS.replace("position_mm (or x_mm and y_mm), force_n", "x_mm, y_mm, force_n").replace(
    "position_mm (or x_mm and y_mm) and", "x_mm and y_mm and"
)
COPY = "one is a copy: correct it, or take its column out"
BAD: dict[str, tuple[Rows, str, str]] = {
    "three loads": (ROWS[:3], HEAD, "3 loads are fewer than 4; measure some 20, over the whole range of contacts"),
    "too many loads": (even(10_001, 1500), HEAD, "10001 loads are more than 10000; leave some out"),
    "too many places": (even(1501, 1501), HEAD, "loads are at 1501 places, more than 1500; leave some out"),
    "two places": (
        even(5, 2),
        HEAD,
        "all loads are at 2 of at least 3 places; spread them over the range of contacts",
    ),
    "two of y": (
        [(row[0], 20 + 50 * (number % 2), *row[2:]) for number, row in enumerate(PLANE_ROWS)],
        PLANE,
        "all loads are at 2 of at least 3 y_mm; spread them over the range of contacts",
    ),
    "on a line": (
        [
            (x, y + 0.8 * (number == 1), *row[2:])
            for number, ((x, y), row) in enumerate(zip(LINES, PLANE_ROWS, strict=True))
        ],
        PLANE,
        "all loads are on one line; spread them over both axes of the range of contacts",
    ),
    "silent": (
        [(*row[:3], 0) for row in ROWS],
        HEAD,
        "b is 0 under all loads; check the sensor, or take its column out",
    ),
    "copied": (
        [(*row[:3], row[2]) for row in ROWS],
        HEAD,
        f"a and b show the same under all loads, to the last digit; {COPY}",
    ),
    "no rows": ([], HEAD, "it has no loads, only the names of columns; add a row for each load"),
    "before the end": (changed(2, 0, -0.5), HEAD, "line 4: position_mm is -0.5; count places from the left end"),
    "below the corner": (
        changed(1, 1, -3, PLANE_ROWS),
        PLANE,
        "line 3: y_mm is -3; count places from the lower left corner",
    ),
    "no force": (changed(3, 1, 0), HEAD, "line 5: force_n = 0 is no load; take the row out"),
    "pulled": (
        changed(0, 1, -4),
        HEAD,
        "line 2: force_n = -4 pulls; state forces that press as positive",
    ),
    "too large": (
        changed(1, 2, 1.1e9),
        HEAD,
        "line 3: a_deflection_mm is 1.1e+09, which nobody measures; correct it",
    ),
    "along and across": (
        ROWS,
        HEAD.replace("b_deflection_mm", "y_mm"),
        "it has both position_mm and y_mm; state places along one axis, or along x and y",
    ),
    "no force column": (
        ROWS,
        HEAD.replace("force_n", "force_kg"),
        f"column force_n is missing; convert force_kg: one g weighs 0.00981 N, one kg 9.81 N; {OF_LOADS}",
    ),
    "nothing but sensors": (
        ROWS,
        HEAD.replace("position_mm,force_n", "position_m,force_g"),
        f"column position_mm is missing; convert position_m: one um is 0.001 mm, one m 1000 mm; {OF_LOADS}",
    ),
    "no x": (
        PLANE_ROWS,
        PLANE.replace("x_mm", "x_cm"),
        f"column x_mm is missing; convert x_cm: one um is 0.001 mm, one m 1000 mm; {OF_PLANES}",
    ),
    "no y": (
        PLANE_ROWS,
        PLANE.replace("y_mm", "remark"),
        f"column y_mm is missing; {OF_PLANES}",
    ),
    "lengths": (
        ROWS,
        HEAD.replace("b_deflection_mm", "b_deflection_um"),
        "column b_deflection_um: lengths are in mm; convert it, one um is 0.001 mm, and name it so",
    ),
    "no sensors": ([row[:2] for row in ROWS], "position_mm,force_n", f"it has no column of a sensor; {OF_LOADS}"),
    "unknown": (
        ROWS,
        HEAD.replace("b_deflection_mm", "b_mm"),
        f"column 'b_mm' is not known; {OF_LOADS}",
    ),
    "half named": (
        ROWS,
        HEAD.replace("b_deflection_mm", "deflection"),
        f"column 'deflection' is not known; {OF_LOADS}",
    ),
    "not a name": (
        ROWS,
        HEAD.replace("b_deflection_mm", "b c_deflection_mm"),
        "column b c_deflection_mm does not begin with the name of a sensor, as s1_deflection_mm does",
    ),
    "one sensor twice": (
        ROWS,
        "position_mm,force_n,a_deflection_V,a_deflection_A",
        "two columns are of a, in different units; take one out",
    ),
    "one of several sensors twice": (
        [(*row, 0.1, 0.2) for row in ROWS],
        "position_mm,force_n,a_deflection_V,b_deflection_V,c_deflection_V,b_deflection_A",
        "two columns are of b, in different units; take one out",
    ),
    "two kinds": (
        ROWS,
        "position_mm,force_n,a_deflection_V,b_deflection_A",
        "a is in V and b in A; sensors of one structure are of one kind, with one unit",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_a_table_that_cannot_be_used_is_refused_by_its_reason(name: str) -> None:
    rows, head, said = BAD[name]
    with pytest.raises(RecordingError) as refused:
        read(rows, head)
    assert str(refused.value) == f"loads.csv: {said}"


TAKEN: dict[str, tuple[Rows, str]] = {
    "four loads": (ROWS, HEAD),
    "most loads and places": (even(10_000, 1500), HEAD),
    "three places": (even(5, 3), HEAD),
    "largest number": (changed(1, 2, 1e9), HEAD),
    "left end": (changed(2, 0, 0), HEAD),
    "places of two axes": (PLANE_ROWS, PLANE),
    # The points spread by some 180 mm along their line, so that 10 mm across it are enough.
    "beside a line": (
        [
            (x, y + 12 * (number == 1), *row[2:])
            for number, ((x, y), row) in enumerate(zip(LINES, PLANE_ROWS, strict=True))
        ],
        PLANE,
    ),
    "columns of record": (
        [(*row, 1, 9, "good", "x") for row in ROWS],
        f"{HEAD},unix_time_s,a_counts,b_quality,remark",
    ),
}


@pytest.mark.parametrize("name", TAKEN)
def test_a_table_that_can_be_used_is_taken(name: str) -> None:
    rows, head = TAKEN[name]
    read(rows, head)


def test_rows_of_one_load_are_its_samples_and_only_good_ones_count() -> None:
    head = f"load,{HEAD},b_quality"
    rows: Rows = [
        (7, 10, 5, 0.1, 0.3, "good"),
        (7, 10, 5, 0.2, 0.5, "bad"),
        (7, 10, 5, 0.6, 0.4, "good"),
        (3, 60, 4, 0.25, 0.35, "good"),
        (4, 130, 4, 0.3, 0.2, "good"),
        (5, 250, 8, 0.15, 0.4, "good"),
    ]
    loads = read(rows, head)
    assert (loads.names, loads.axes, loads.is_per_newton, loads.unit) == (("a", "b"), 1, False, "mm")
    assert loads.place_mm.tolist() == [[10], [60], [130], [250]]
    assert loads.force_n.tolist() == [5, 4, 4, 8]
    assert loads.deflection_mm == pytest.approx(np.array([[0.3, 0.35], [0.25, 0.35], [0.3, 0.2], [0.15, 0.4]]))
    assert loads.influence_mm_per_n[0] == pytest.approx([0.06, 0.07])
    for column, value in ((1, 11), (2, 6)):
        with pytest.raises(RecordingError, match=r"load 7 is at two places or has two forces in lines 2 to 4; number"):
            read(changed(2, column, value, rows), head)
    silent = changed(0, 5, "bad", changed(2, 5, "bad", rows))
    with pytest.raises(RecordingError, match=r"csv: line 2: b has no good sample of this load; take the load out$"):
        read(silent, head)
    with pytest.raises(RecordingError, match=r"csv: line 6: b has no good sample of this load"):
        read(changed(4, 5, "bad", rows), head)


def test_rows_without_a_number_are_loads_of_their_own() -> None:
    rows, _ = parse_rows("load,a\n7,1\n,1\n7,1\n,1\n-3,1\n", "loads.csv")
    assert list(rows_of_loads(rows).values()) == [[0, 2], [1], [3], [4]]


def test_a_table_is_written_with_nine_digits_and_read_again() -> None:
    loads = read([(10, 3, 0.1234567891, 1e-7), *ROWS[1:]])
    text = loads.to_csv()
    assert text.splitlines()[:2] == [HEAD, "10,3,0.123456789,1e-07"]
    again = parse_loads(text, "x")
    assert again.to_csv() == text
    per_newton = parse_loads(table([(row[0], *row[2:]) for row in ROWS], "position_mm,a_V_per_n,b_V_per_n"), "x")
    assert (per_newton.is_per_newton, per_newton.unit, per_newton.force_n.tolist()) == (True, "V", [1] * 4)
    assert per_newton.to_csv().splitlines()[:2] == ["position_mm,a_V_per_n,b_V_per_n", "10,0.1,0.3"]
    plane = read(PLANE_ROWS, PLANE)
    assert plane.to_csv().splitlines()[:2] == [PLANE, "10,20,5,0.1,0.3"]
