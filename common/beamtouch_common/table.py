"""Tables of text with aligned columns, for terminals and in Markdown."""

from collections.abc import Collection, Iterator, Sequence

Row = Sequence[str]


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


def _pad(rows: Sequence[Row], right: Collection[int] = ()) -> Iterator[list[str]]:
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in rows:
        yield [
            cell.rjust(width) if place in right else cell.ljust(width)
            for place, (cell, width) in enumerate(zip(row, widths, strict=True))
        ]
