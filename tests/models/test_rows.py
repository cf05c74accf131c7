"""Rows of CSV files: their cells by column, and what is wrong with a file in one line."""

from pathlib import Path

import pytest

from beamtouch_models.design.rows import RecordingError, Row, parse_rows, read_rows


def test_rows_have_their_lines_and_their_cells_by_column() -> None:
    """Empty lines are passed over; a short row has empty cells, and what is beyond the columns is empty, too."""
    rows, columns = parse_rows('load, position_mm ,force_n\n1, 2.5,3,\n\n,,\n2,"7,5"\n', "x.csv")
    assert columns == ["load", "position_mm", "force_n"]
    assert rows == [
        Row(2, {"load": "1", "position_mm": "2.5", "force_n": "3"}),
        Row(5, {"load": "2", "position_mm": "7,5", "force_n": ""}),
    ]
    assert parse_rows("", "x.csv") == ([], [])
    one, _ = parse_rows("place\n1,5\n", "x.csv")
    assert one == [Row(2, {"place": "1"})]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (
            "a;b\n1;2",
            "x.csv: semicolons separate the columns; separate them by commas, and write decimals with a point",
        ),
        ("a\tb\n1\t2", "x.csv: tabs separate the columns; separate them by commas, and write decimals with a point"),
        ("a,b,a\n1,2,3", "x.csv: two columns are named a; take one out"),
        ("a,b\n1,2\n3,4,5", "x.csv: line 3 has 3 values in 2 columns; write decimals with a point"),
        ("a,b,c\n1,2,3,,4", "x.csv: line 2 has 5 values in 3 columns; write decimals with a point"),
    ],
)
def test_a_file_that_is_no_table_is_refused_in_one_line(text: str, said: str) -> None:
    with pytest.raises(RecordingError) as refused:
        parse_rows(text, "x.csv")
    assert str(refused.value) == said


def test_separators_within_names_and_columns_without_names_are_taken() -> None:
    rows, columns = parse_rows("a;b,c,,\n1,2,3,4", "x.csv")
    assert columns == ["a;b", "c", "", ""]
    assert rows[0].cells["a;b"] == "1"


def test_a_number_is_asked_for_without_its_unit() -> None:
    row = Row(7, {"force_n": "12.5", "load": "3", "half": "2.5", "with_unit": "12 N", "empty": ""})
    assert (row.number_in("force_n"), row.load()) == (12.5, 3)
    for column, fault in (("with_unit", "states '12 N', which is not a number"), ("empty", "is empty")):
        with pytest.raises(RecordingError) as refused:
            row.number_in(column)
        assert str(refused.value) == f"line 7: {column} {fault}; write 12.5, without a unit"
    with pytest.raises(RecordingError, match=r"^line 7: load is 2\.5; number the loads 1, 2, 3$"):
        Row(7, {"load": "2.5"}).load()


def test_a_file_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    with pytest.raises(RecordingError) as refused:
        read_rows(tmp_path / "none.csv")
    assert str(refused.value) == f"{tmp_path / 'none.csv'}: No such file or directory"
    (tmp_path / "some.csv").write_text("a\n1\n")
    assert read_rows(tmp_path / "some.csv")[0] == [Row(2, {"a": "1"})]
