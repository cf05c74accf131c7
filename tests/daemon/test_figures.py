"""Counts and lengths as the commands show and record them."""

import math

import pytest

from beamtouch_daemon.measuring.figures import counts_text, heads_with_unit, rounded


@pytest.mark.parametrize(
    ("counts", "shown"),
    [
        (21_345.0, "21345"),
        (21_345.0625, "21345.06"),  # a mean of 16 conversions
        (0.123456789, "0.1234568"),
        (999_999.4, "999999.4"),
        (1_000_000.4, "1000000"),
        (-1_234_567.8, "-1234568"),
        (8_388_607.0, "8388607"),
        (1e12, "1000000000000"),
        (1.5e12, "1.5e+12"),
        (-3.4028235e38, "-3.402823e+38"),
    ],
)
def test_counts_are_shown_in_full_and_fractions_to_seven_digits(counts: float, shown: str) -> None:
    assert counts_text(counts) == shown


def test_nothing_is_shown_as_minus_zero() -> None:
    assert counts_text(-0.0) == "0"
    assert [math.copysign(1, rounded(value, 3)) for value in (-0.0, -0.0004)] == [1, 1]
    assert (rounded(-1.23456, 3), rounded(2.5004, 2)) == (-1.235, 2.5)


HEADS = ("surface", "gap", "quality")


@pytest.mark.parametrize(
    ("units", "heads", "ends"),
    [
        (["mm", "mm"], ["surface", "gap mm", "quality"], ["", ""]),
        (["uT", "uT", "uT"], ["surface", "gap uT", "quality"], ["", "", ""]),
        (["mm", "uT"], ["surface", "gap", "quality"], [" mm", " uT"]),
        (["uT"], ["surface", "gap uT", "quality"], [""]),
        ([], ["surface", "gap mm", "quality"], []),
    ],
)
def test_one_unit_of_all_rows_stands_in_the_head_and_several_behind_the_figures(
    units: list[str], heads: list[str], ends: list[str]
) -> None:
    assert heads_with_unit(HEADS, ("gap",), units) == (heads, ends)
