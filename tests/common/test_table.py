"""Tables of text."""

from beamtouch_common.table import aligned, aligned_markdown

HEAD, ROWS = ("channel", "mm", "is"), [("s1", "1.25", "good"), ("s2", "-", "")]


def test_columns_are_aligned_and_numbers_stand_to_the_right() -> None:
    assert aligned(HEAD, ROWS, right=(1,)) == [
        "channel    mm  is",
        "s1       1.25  good",
        "s2          -",
    ]


def test_a_table_of_markdown_is_aligned() -> None:
    assert aligned_markdown(HEAD, ROWS).splitlines() == [
        "| channel | mm   | is   |",
        "| ------- | ---- | ---- |",
        "| s1      | 1.25 | good |",
        "| s2      | -    |      |",
    ]
