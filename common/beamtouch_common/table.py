"""Tables of text with aligned columns, for terminals and in Markdown; text within the width of a page."""

import textwrap
from collections.abc import Collection, Iterator, Sequence

Row = Sequence[str]
WIDTH = 100
"""Characters in a line that is printed for people, at most."""


def aligned(head: Row, rows: Sequence[Row], right: Collection[int] = ()) -> list[str]:
    """Return the lines of a table, with two spaces between its columns.

    Parameters
    ----------
    head, rows : the cells, equally many in each row
    right : places of the columns whose cells stand to the right, as numbers do
    """
    return ["  ".join(cells).rstrip() for cells in _pad([head, *rows], right)]


def aligned_markdown(head: Row, rows: Sequence[Row]) -> str:
    """Return a Markdown table whose columns are aligned, so that a terminal shows it well, too."""
    headings, *others = _pad([head, *rows])
    rule = ["-" * len(heading) for heading in headings]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in [headings, rule, *others])


def in_columns(rows: Sequence[Row], width: int = WIDTH) -> list[str]:
    """Return lines whose parts stand in columns; a last part that is too long goes on below its own beginning."""
    *widths, _ = (max(map(len, column)) for column in zip(*rows, strict=True))
    lines: list[str] = []
    for *parts, last in rows:
        begin = "".join(f"{part:<{column}}  " for part, column in zip(parts, widths, strict=True))
        lines += wrapped(last, width, begin) if begin else [last]
    return lines


def wrapped(text: str, width: int = WIDTH, begin: str = "") -> list[str]:
    """Return the lines of a text after `begin`, the later ones indented as far; long words stay whole."""
    lines = textwrap.wrap(
        text,
        width,
        initial_indent=begin,
        subsequent_indent=" " * len(begin),
        break_long_words=False,
        break_on_hyphens=False,
    )
    return lines or [begin.rstrip()]


def _pad(rows: Sequence[Row], right: Collection[int] = ()) -> Iterator[list[str]]:
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in rows:
        yield [
            cell.rjust(width) if place in right else cell.ljust(width)
            for place, (cell, width) in enumerate(zip(row, widths, strict=True))
        ]
