"""`design-sensors reproduce`: the paper's figures as plots, numbers and a table of verdicts."""

import argparse
import sys
from pathlib import Path

from beamtouch_models.commands.options import add_json, add_seed, folder_of, shown_progress
from beamtouch_models.printing import Result, Table, show


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.add_argument(
        "-o", "--output", type=Path, required=True, metavar="DIR", help="folder for the plots and numbers"
    )
    add_seed(parser)
    add_json(parser)


def run(options: argparse.Namespace) -> None:
    """Compute everything, write the folder, print the table."""
    from beamtouch_common.files import write_atomically
    from beamtouch_models.reproduction.paper import SOURCE, TITLE
    from beamtouch_models.reproduction.reproduce import reproduce

    folder = folder_of(options.output)
    with shown_progress() as progress:
        found = reproduce(options.seed, progress)
    files = found.files()
    for name, text in files.items():
        write_atomically(folder / name, text.encode())
    head = ("statement", "paper", "here", "verdict")
    rows = [(row.quantity, row.paper or "-", row.ours, row.verdict_text) for row in found.rows]
    differing = [place for place, row in enumerate(found.rows) if row.verdict == "differs"]
    table = Table(head, rows, text=head, bold=differing, ruled=True)
    fields = {"output": str(folder), "files": sorted(files), **found.results()}
    show(
        Result(fields, [f"The paper: {TITLE}. {SOURCE}", table, f"{found.summary()} (seed {found.seed})"]),
        as_json=options.json,
    )
    if not options.json:
        print(f"{len(files)} files in {folder}: plots, results.json, table.md", file=sys.stderr)
