"""Numbers and tables as people read them."""

from decimal import Context, Decimal

import pytest
from hypothesis import given
from hypothesis import strategies as st

from beamtouch_common.digits import digits
from beamtouch_common.table import WIDTH, aligned, aligned_markdown, in_columns, wrapped

HEAD, ROWS = ("channel", "mm", "is"), [("s1", "1.25", "good"), ("s2", "-", "")]


@pytest.mark.parametrize(
    ("value", "count", "text"),
    [
        (160.3, 2, "160"),
        (99.6, 2, "100"),
        (0.0, 3, "0"),
        (-1234.5, 3, "-1230"),
        (12345678.0, 3, "1.23e+07"),
        (9999999.0, 3, "1e+07"),
        (2e-5, 3, "0.00002"),
        (9.996e-7, 3, "0.000001"),
        (3.16e-7, 3, "3.16e-07"),
        (float("inf"), 3, "inf"),
        (float("nan"), 3, "nan"),
    ],
)
def test_numbers_of_ordinary_size_have_no_exponent(value: float, count: int, text: str) -> None:
    assert digits(value, count) == text


@given(st.floats(1e-12, 1e12) | st.floats(-1e12, -1e-12), st.integers(1, 6))
def test_the_number_is_the_rounded_one(value: float, count: int) -> None:
    rounded = Context(prec=count).create_decimal(Decimal(value))
    assert Decimal(digits(value, count)) == rounded
    assert ("e" in digits(value, count)) == (not Decimal("1e-6") <= abs(rounded) < 10**7)


def test_columns_of_tables_are_aligned_and_numbers_stand_to_the_right() -> None:
    assert aligned(HEAD, ROWS, right=(1,)) == [
        "channel    mm  is",
        "s1       1.25  good",
        "s2          -",
    ]
    assert aligned_markdown(HEAD, ROWS).splitlines() == [
        "| channel | mm   | is   |",
        "| ------- | ---- | ---- |",
        "| s1      | 1.25 | good |",
        "| s2      | -    |      |",
    ]


def test_a_long_last_part_goes_on_below_its_beginning_and_short_ones_stay() -> None:
    assert in_columns([("a", "one two three"), ("long", "four")], width=14) == [
        "a     one two",
        "      three",
        "long  four",
    ]
    command = "design-sensors build " + "x" * WIDTH
    assert in_columns([(command,)]) == [command]  # to be pasted
    assert in_columns([("label", "")]) == ["label"]


@given(st.text(st.characters(codec="ascii", categories=["L", "Zs"]), max_size=400))
def test_wrapped_lines_have_all_words_and_fit_unless_a_word_does_not(text: str) -> None:
    lines = wrapped(text, 30, "note: ")
    assert [word for line in lines for word in line.split()] == ["note:", *text.split()]
    assert all(len(line) <= 30 or len(line.split()) <= 2 for line in lines)
    assert all(line.startswith("      ") for line in lines[1:])
