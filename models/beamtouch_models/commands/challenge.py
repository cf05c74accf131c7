"""`design-sensors challenge`: puts a model through a world of contacts, transients, errors and faults."""

import argparse
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from beamtouch_common.digits import digits
from beamtouch_common.errors import InputError
from beamtouch_common.outline import names_of
from beamtouch_models.commands.shared import shown_progress
from beamtouch_models.commands.workers import spread_over
from beamtouch_models.design.printing import Result, Table, Words
from beamtouch_models.lab.challenge.challenge import challenge, misses
from beamtouch_models.runtime import loading
from beamtouch_models.runtime.decision.evidence import LOG_ODDS


def run(options: argparse.Namespace) -> Result:
    """Challenge the model and return the rows of both groups."""
    content = loading.read(options.model)
    model = loading.load_bytes(content, str(options.model))
    # Without these, a model cannot say what it does not know.
    needed = [*(name for axis in model.metadata.axes for name in names_of(axis, "mm")[1:]), LOG_ODDS]
    lacking = ", ".join(name for name in needed if name not in model.outputs)
    if lacking:
        raise InputError(f"{options.model}: its graph does not give {lacking}; build it with another --estimator")
    with spread_over(options.workers, options.cluster) as spread, shown_progress() as progress:
        rows = challenge(content, draws=options.draws, seed=options.seed, progress=progress, spread=spread)
    told = [asdict(row) | {"misses": misses(row)} for row in rows]
    groups = [[row for row in told if row["honest"] is honest] for honest in (True, False)]
    missed = [f"{row['name']} ({', '.join(row['misses'])})" for row in told if row["misses"]]
    return Result(
        {"model": model.identity, "draws": options.draws, "seed": options.seed, "rows": told},
        [
            f"{model.identity}, {options.draws} simulations of each case",
            *(
                _table(f"{group}: {part}", rows, columns)
                for (group, parts), rows in zip(TABLES.items(), groups, strict=True)
                for part, columns in parts.items()
            ),
            _LEGEND,
            Words(f"Rows that miss the goals: {'; '.join(missed) or 'none'}."),
        ],
    )


ANSWERED = {name: name for name in ("unexplained", "noted", "clear", "silent")}
TABLES = {
    "one contact, honestly measured": {
        "errors and intervals": {
            "samples": "samples",
            "error, mm": "error_mm",
            "interval, mm": "interval_mm",
            "held, %": "held",
            "unsteady, %": "held_unsteady",
            "other, %": "held_noted",
        },
        "what was answered, %": {**ANSWERED, "misleading": "misleading", "ghosts": "ghosts"},
    },
    "faults and other worlds": {
        "what was noticed, %": {
            "noticed": "noticed",
            "power": "power",
            "misleading": "misleading",
            "held": "held",
            "error, mm": "error_mm",
        },
        "what was answered, %": {"samples": "samples", **ANSWERED},
    },
}
"""The tables of each group of cases: the figures of a row under their headings."""


def _table(title: str, rows: Sequence[dict[str, Any]], columns: dict[str, str]) -> Table:
    cells = [(row["name"], *(_cell(key, row[key]) for key in columns.values())) for row in rows]
    return Table(("case", *columns), cells, title, bold=[place for place, row in enumerate(rows) if row["misses"]])


def _cell(key: str, value: float | None) -> str:
    """Return a count, a length in mm, or a share in percent as text."""
    if value is None or key == "samples":
        return "-" if value is None else str(value)
    if key.endswith("_mm"):
        return digits(value, 3)
    return "<0.01" if 0 < value < 1e-4 else digits(100 * value, 3)


_LEGEND = (
    ("samples", "number of samples of the row; all shares are of them, unless other words stand here"),
    ("error", "mean error of the place of the contacts that are answered, with or without a note"),
    ("interval", "median length of the intervals of the place, with or without a note"),
    ("held", "of the contacts without a note, those whose interval holds the truth; it is made to hold 95 %"),
    ("unsteady", "the same of the contacts with this note, which says that the beam moves"),
    ("other", "the same of the contacts with another note"),
    ("unexplained", "neither rest nor one contact explains the sample, so no position is given"),
    ("noted", "a contact with a note"),
    ("clear", "said to be clear: missed, where something acts on the beam"),
    ("silent", "no answer, as too few sensors work or are within their range"),
    ("misleading", "a contact without a note that is not there, or further off than twice the half-interval"),
    ("ghosts", "simulations in which a contact begins again"),
    ("noticed", "unexplained, or a contact with a note"),
    ("power", "what a test notices that knows which fault to look for, with as many false alarms"),
)
