"""`design-sensors reproduce`: the paper's figures as plots, numbers and a table of verdicts."""

import argparse

from beamtouch_common.files import write_atomically
from beamtouch_models.commands.shared import folder_of, shown_progress
from beamtouch_models.design.printing import Result, Table, Words
from beamtouch_models.lab.reproduction.paper import HEAD, SOURCE, TITLE
from beamtouch_models.lab.reproduction.reproduce import reproduce


def run(options: argparse.Namespace) -> Result:
    """Compute everything, write the folder, and return the table."""
    folder = folder_of(options.output)
    with shown_progress() as progress:
        reproduction = reproduce(options.seed, progress)
    files = reproduction.files()
    for name, text in files.items():
        write_atomically(folder / name, text.encode())
    differing = [place for place, row in enumerate(reproduction.rows) if row.verdict == "differs"]
    table = Table(HEAD, [row.cells for row in reproduction.rows], text=HEAD, bold=differing, ruled=True)
    return Result(
        {"output": str(folder), "files": sorted(files), **reproduction.results()},
        [Words(f"The paper: {TITLE}. {SOURCE}"), table, f"{reproduction.summary()} (seed {reproduction.seed})"],
        f"{len(files)} files in {folder}: plots, results.json, table.md",
    )
