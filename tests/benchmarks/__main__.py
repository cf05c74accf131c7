"""`make bench`: every benchmark of this folder in one run, as a table and as JSON.

A benchmark is a module `bench_*.py` with a function `run()` that returns rows: a name, a value, its unit, and where
there is one the goal. Figures are ratios within the run, as the machine is noisy. Without names, all run but the
long ones, so that a whole run ends within ten minutes.
"""

import argparse
import importlib
import json
import sys
import time
from pathlib import Path

from rich.box import SIMPLE
from rich.console import Console
from rich.table import Table

HERE = Path(__file__).parent
_COLUMNS = ("name", "value", "unit", "goal")
BY_NAME = ("drift", "false_alarms", "health", "zones")
"""Benchmarks that would take most of the ten minutes of a whole run."""


def main() -> int:
    """Run the benchmarks that were asked for; returns 0."""
    available = sorted(path.stem.removeprefix("bench_") for path in HERE.glob("bench_*.py"))
    left_out = ", ".join(BY_NAME)
    parser = argparse.ArgumentParser(description="Measure, as ratios within one run.")
    parser.add_argument(
        "names",
        nargs="*",
        metavar="NAME",
        help=f"benchmarks to run: {', '.join(available)} (default: all but {left_out})",
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the rows to FILE")
    options = parser.parse_args()
    if unknown := set(options.names) - set(available):
        parser.error(f"no benchmark {', '.join(sorted(unknown))}; there are {', '.join(available)}")
    console = Console(width=None if sys.stdout.isatty() else 120)
    rows: list[dict[str, object]] = []
    sys.path.insert(0, str(HERE.parent))  # for the scenes that tests and benchmarks share
    for name in options.names or [name for name in available if name not in BY_NAME]:
        start = time.monotonic()
        print(f"{name} ...", file=sys.stderr, flush=True)
        found = importlib.import_module(f"bench_{name}").run()
        console.print(_table(f"{name}, {time.monotonic() - start:.0f} s", found))
        rows += [{"benchmark": name, **row} for row in found]
    if options.json is not None:
        options.json.write_text(json.dumps(rows, indent=1) + "\n")
    return 0


def _table(title: str, rows: list[dict[str, object]]) -> Table:
    table = Table(title=title, box=SIMPLE)
    for column in ("", "value", "unit", "goal", "and"):
        table.add_column(column, justify="right" if column == "value" else "left")
    for row in rows:
        further = ", ".join(f"{key} {_text(value)}" for key, value in row.items() if key not in _COLUMNS and value)
        table.add_row(*(_text(row.get(column)) for column in _COLUMNS), further)
    return table


def _text(value: object) -> str:
    if value is None:
        return ""
    return f"{value:.4g}" if isinstance(value, float) else str(value)


if __name__ == "__main__":
    sys.exit(main())
