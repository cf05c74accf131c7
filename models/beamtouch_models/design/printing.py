"""The form of a command's result, its one printer, the same in Markdown, and notes beside it."""

import json
import sys
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from beamtouch_common.table import aligned_markdown

WIDTH_WITHOUT_TERMINAL = 180
"""Characters in a line of a table that goes to a file or a pipe."""


@dataclass(frozen=True)
class Table:
    """Rows under headings; a column of numbers stands to the right."""

    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    title: str = ""
    text: Collection[str] = ()
    """Headings of the columns that hold text, beside the first."""
    bold: Collection[int] = ()
    """Places of rows that stand out."""
    ruled: bool = False
    """Whether lines separate the rows, as cells of several lines need."""


Block = Table | Sequence[tuple[str, ...]] | str
"""A table, lines whose parts stand in columns, or a paragraph."""


@dataclass(frozen=True)
class Result:
    """A result of a command."""

    fields: dict[str, Any]
    """For programs: one JSON object, whose keys are documented."""
    rows: Iterable[Block]
    """For people."""
    remark: str = ""
    """For people, beside the result: where the files are."""


def show(result: Result, *, as_json: bool) -> None:
    """Print a result, as one JSON object or as text."""
    if as_json:
        print(json.dumps(result.fields), flush=True)
        return
    for block in result.rows:
        if isinstance(block, Table):
            _print_table(block)
        elif isinstance(block, str):
            print(block)
        else:
            print("\n".join(_in_columns(block)))
    if result.remark:
        print(result.remark, file=sys.stderr)


def note(*texts: str, kind: str = "note") -> None:
    """Print notes or warnings on standard error, where no program takes them for a result; empty ones are none."""
    for text in texts:
        if text:
            print(f"{kind + ':':<8} {text}", file=sys.stderr)


def markdown(title: str, blocks: Iterable[Block]) -> str:
    """Return blocks as a page in Markdown; lines in columns become a block of code."""
    parts = [f"# {title}"]
    for block in blocks:
        if isinstance(block, Table):
            parts += [f"## {block.title[:1].upper()}{block.title[1:]}", aligned_markdown(block.head, block.rows)]
        elif isinstance(block, str):
            parts.append(block)
        else:
            parts.append("\n".join(["```", *_in_columns(block), "```"]))
    return "\n\n".join(parts) + "\n"


def _in_columns(lines: Sequence[tuple[str, ...]]) -> Iterable[str]:
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    for parts in lines:
        yield "  ".join(part.ljust(width) for part, width in zip(parts, widths, strict=True)).rstrip()


def _print_table(table: Table) -> None:
    from rich.box import SIMPLE_HEAD
    from rich.console import Console
    from rich.table import Table as RichTable

    drawn = RichTable(title=table.title or None, box=SIMPLE_HEAD, title_justify="left", show_lines=table.ruled)
    for place, heading in enumerate(table.head):
        is_text = place == 0 or heading in table.text
        drawn.add_column(heading, justify="left" if is_text else "right", overflow="fold")
    for place, cells in enumerate(table.rows):
        drawn.add_row(*cells, style="bold" if place in table.bold else None)
    is_terminal = sys.stdout is not None and sys.stdout.isatty()  # None if it was closed before the start
    width = None if is_terminal else WIDTH_WITHOUT_TERMINAL
    Console(width=width, highlight=False, markup=False).print(drawn)
