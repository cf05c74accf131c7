"""The tables of docs/challenge.md, from what `design-sensors challenge NAME.onnx --json` prints.

    python tests/benchmarks/challenge_tables.py bench.json conveyor.json

prints them as Markdown, a column for each file.
"""

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from beamtouch_common.digits import digits

Row = dict[str, Any]
Cell = Callable[[Row], str]

LIFTED = "after a lift", "after a tap"
RINGING = "sudden force", "weight laid on", "force in "
TEN = 10
"""Percentages from here on have no decimals."""


def main(files: list[Path]) -> None:
    """Print the tables of all files."""
    columns = {file.stem: {row["name"]: row for row in json.loads(file.read_text())["rows"]} for file in files}
    for title, wanted, cell in TABLES:
        print(f"## {title}\n\n{_table(columns, wanted, cell)}\n")


def _table(columns: dict[str, dict[str, Row]], wanted: Callable[[Row], bool], cell: Cell) -> str:
    """Return a table of the rows wanted; the cell of a row that a column has not, or that is not wanted, is empty."""
    names = dict.fromkeys(name for rows in columns.values() for name, row in rows.items() if wanted(row))
    lines = []
    for name in names:
        found = [rows.get(name) for rows in columns.values()]
        lines.append((name, *(_bold(cell(row), row) if row and wanted(row) else "" for row in found)))
    whole = [("case", *columns), ("---",) * (1 + len(columns)), *lines]
    return "\n".join(f"| {' | '.join(line)} |" for line in whole)


def _bold(text: str, row: Row) -> str:
    return f"**{text}**" if text and row["misses"] else text


def _shares(row: Row, *names: str) -> str:
    """Return shares of a row in percent with two digits, or a dash for one that no sample counts for."""
    return " / ".join("-" if row[name] is None else f"{_rounded(100 * row[name])}" for name in names)


def _rounded(percent: float) -> str:
    return f"{percent:.0f}" if percent >= TEN else f"{round(percent, 2):.2g}"


def _interval(row: Row) -> str:
    return "" if row["interval_mm"] is None else digits(row["interval_mm"], 3)


def _is_lifted(row: Row) -> bool:
    return bool(row["name"].startswith(LIFTED) or row["name"].endswith(", lifted"))


def _lost(row: Row) -> bool:
    return bool(row["honest"] and (row["name"].startswith("gap of") or row["name"].endswith(" lost")))


def _rings(row: Row) -> bool:
    return bool(row["honest"] and row["name"].startswith(RINGING)) and not _lost(row)


def _drifts(row: Row) -> bool:
    return bool(row["honest"] and row["name"].startswith("zeros drift")) and not _is_lifted(row)


def _still_or_moving(row: Row) -> bool:
    return bool(row["honest"]) and not (_is_lifted(row) or _lost(row) or _rings(row) or _drifts(row))


def _is_fault(row: Row) -> bool:
    return not row["honest"]


def _judged(row: Row) -> str:
    return _shares(row, "held", "held_unsteady", "noted", "misleading")


TABLES: tuple[tuple[str, Callable[[Row], bool], Cell], ...] = (
    ("One contact, honestly measured", _still_or_moving, _judged),
    ("Lost readings", _lost, _judged),
    ("A beam that rings", _rings, _judged),
    ("Zeros that drift", _drifts, _judged),
    ("After a lift or a tap", _is_lifted, lambda row: _shares(row, "clear", "noted", "ghosts")),
    ("Faults and other worlds", _is_fault, lambda row: _shares(row, "noticed", "power")),
    ("Width of the intervals", _still_or_moving, _interval),
)

if __name__ == "__main__":
    main([Path(name) for name in sys.argv[1:]])
