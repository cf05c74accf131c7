"""`design-sensors reproduce`: the paper's figures as plots, numbers and a table of verdicts."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from beamtouch_common.files import write_atomically
from beamtouch_models.commands.options import add_json, add_seed, folder_of, shown_progress
from beamtouch_models.commands.printing import Block, Table, show

if TYPE_CHECKING:
    from beamtouch_models.reproduction.reproduce import Reproduction


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.add_argument(
        "-o", "--output", type=Path, required=True, metavar="DIR", help="folder for the plots and numbers"
    )
    add_seed(parser)
    add_json(parser)


def run(options: argparse.Namespace) -> None:
    """Compute everything, write the folder, print the table."""
    from beamtouch_models.reproduction.reproduce import reproduce

    folder = folder_of(options.output)
    with shown_progress() as progress:
        found = reproduce(options.seed, progress)
    files = found.files()
    for name, text in files.items():
        write_atomically(folder / name, text.encode())
    show(Reproduced(found, folder, sorted(files)), as_json=options.json)
    if not options.json:
        print(f"{len(files)} files in {folder}: plots, results.json, table.md", file=sys.stderr)


@dataclass(frozen=True)
class Reproduced:
    """The reproduction, with the files that were written."""

    found: Reproduction
    folder: Path
    files: list[str]

    def rows(self) -> Iterator[Block]:
        """Return the table of verdicts and their summary."""
        rows = [(row.quantity, row.paper or "-", row.ours, row.verdict_text) for row in self.found.rows]
        head = ("statement", "paper", "here", "verdict")
        differing = [place for place, row in enumerate(self.found.rows) if row.verdict == "differs"]
        yield Table(head, rows, text=head, bold=differing, ruled=True)
        yield f"{self.found.summary()} (seed {self.found.seed})"

    def to_json(self) -> dict[str, Any]:
        """Return all results."""
        return {"output": str(self.folder), "files": self.files, **self.found.results()}
