"""`design-sensors reproduce`: the paper's figures as plots, numbers and a table of verdicts."""

import argparse
import json
import sys
from pathlib import Path

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from beamtouch_common.errors import InputError
from beamtouch_common.files import write_atomically
from beamtouch_models.commands.progress import shown_progress
from beamtouch_models.reproduction.reproduce import Reproduction, reproduce

WIDTH_WITHOUT_TERMINAL = 160


def run(options: argparse.Namespace) -> None:
    """Compute everything, write the folder, print the table."""
    folder = folder_of(options.output)
    with shown_progress() as progress:
        found = reproduce(options.seed, progress)
    files = found.files()
    for name, text in files.items():
        write_atomically(folder / name, text.encode())
    if options.json:
        print(json.dumps({"output": str(folder), "files": sorted(files), **found.results()}))
    else:
        show(found)
        print(f"{len(files)} files in {folder}: plots, results.json, table.md", file=sys.stderr)


def show(found: Reproduction) -> None:
    """Print the table of verdicts."""
    console = Console(width=None if sys.stdout.isatty() else WIDTH_WITHOUT_TERMINAL)
    table = Table(box=SIMPLE_HEAD, show_lines=True)
    for heading in ("statement", "paper", "here", "verdict"):
        table.add_column(heading, overflow="fold")
    colours = {"agrees": "green", "differs": "yellow", "not stated": "dim"}
    for row in found.rows:
        table.add_row(row.quantity, row.paper or "-", row.ours, f"[{colours[row.verdict]}]{row.verdict_text}[/]")
    console.print(table)
    console.print(f"{found.summary()} (seed {found.seed})")


def folder_of(path: Path) -> Path:
    """Create the output folder if it is missing; raises InputError if the path is a file."""
    if path.exists() and not path.is_dir():
        message = f"{path}: is a file; give a folder"
        raise InputError(message)
    path.mkdir(parents=True, exist_ok=True)
    return path
