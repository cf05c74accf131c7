"""The form of a command's result, its one printer, the same in Markdown, and notes beside it."""

import json
import shutil
import sys
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, TextIO

from beamtouch_common.table import WIDTH, aligned_markdown, in_columns, wrapped


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
    """True if lines separate the rows, as cells of several lines need."""


@dataclass(frozen=True)
class Words:
    """Paragraphs, a line each, which are broken to fit a page."""

    text: str


Block = Table | Words | Sequence[tuple[str, ...]] | str
"""A table, paragraphs, lines whose parts stand in columns, or text that is printed as it is."""


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
    width = _width_of(sys.stdout)
    for block in result.rows:
        if isinstance(block, Table):
            _print_table(block, width)
        elif isinstance(block, Words):
            print("\n".join(line for text in block.text.splitlines() for line in _paragraph(text, width)))
        elif isinstance(block, str):
            print(block)
        else:
            print("\n".join(in_columns(block, width)))
    if result.remark:
        print(result.remark, file=sys.stderr)


def note(*texts: str, kind: str = "note") -> None:
    """Print notes or warnings on standard error, where no program takes them for a result; empty ones are none."""
    for text in texts:
        if text:
            lines = wrapped(text, _width_of(sys.stderr), f"{kind + ':':<8} ")
            print("\n".join(lines), file=sys.stderr)


def markdown(title: str, blocks: Iterable[Block]) -> str:
    """Return blocks as a page in Markdown; lines in columns become a block of code."""
    parts = [f"# {title}"]
    for block in blocks:
        if isinstance(block, Table):
            parts += [f"## {block.title[:1].upper()}{block.title[1:]}", aligned_markdown(block.head, block.rows)]
        elif isinstance(block, Words):
            parts.append(block.text)
        elif isinstance(block, str):
            parts.append(block)
        else:
            parts.append("\n".join(["```", *in_columns(block), "```"]))
    return "\n\n".join(parts) + "\n"


def _paragraph(text: str, width: int) -> list[str]:
    """Return the lines of a paragraph, or of an item of a list, which stands beside its mark."""
    mark = "- " if text.startswith("- ") else ""
    return wrapped(text.removeprefix(mark), width, mark)


def _width_of(stream: TextIO | None) -> int:
    """Return the characters in a line of a stream: those of a narrow terminal, otherwise those of a page."""
    is_terminal = stream is not None and stream.isatty()  # None if it was closed before the start
    return min(WIDTH, shutil.get_terminal_size().columns) if is_terminal else WIDTH


def _print_table(table: Table, width: int) -> None:
    from rich.box import SIMPLE_HEAD
    from rich.console import Console
    from rich.table import Table as RichTable

    drawn = RichTable(
        title=table.title or None, box=SIMPLE_HEAD, title_justify="left", show_lines=table.ruled, padding=(0, 1, 0, 0)
    )
    for place, heading in enumerate(table.head):
        is_text = place == 0 or heading in table.text
        drawn.add_column(heading, justify="left" if is_text else "right", overflow="fold")
    for place, cells in enumerate(table.rows):
        drawn.add_row(*cells, style="bold" if place in table.bold else None)
    Console(width=width, highlight=False, markup=False).print(drawn)
