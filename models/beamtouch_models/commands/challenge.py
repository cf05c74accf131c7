"""`design-sensors challenge`: puts a model through a world of contacts, transients, errors and faults."""

import argparse
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from beamtouch_common.digits import digits
from beamtouch_common.errors import InputError
from beamtouch_models.commands.shared import shown_progress
from beamtouch_models.commands.workers import spread_over
from beamtouch_models.design.printing import Result, Table
from beamtouch_models.lab.challenge.challenge import challenge, misses
from beamtouch_models.runtime import loading

NEEDED = ("position_low_mm", "position_high_mm", "contact_log_odds")
"""Outputs without which a model cannot say what it does not know."""


def run(options: argparse.Namespace) -> Result:
    """Challenge the model and return the rows of both groups."""
    content = loading.read(options.model)
    model = loading.load_bytes(content, str(options.model))
    lacking = ", ".join(name for name in NEEDED if name not in model.outputs)
    if lacking:
        raise InputError(f"{options.model}: its graph does not give {lacking}; build it with another --estimator")
    with spread_over(options.workers, options.cluster) as spread, shown_progress() as progress:
        rows = challenge(content, draws=options.draws, seed=options.seed, progress=progress, spread=spread)
    told = [asdict(row) | {"misses": misses(row)} for row in rows]
    title = f"{model.identity}, {options.draws} draws"
    missed = [f"{row['name']} ({', '.join(row['misses'])})" for row in told if row["misses"]]
    return Result(
        {"model": model.identity, "draws": options.draws, "seed": options.seed, "rows": told},
        [
            _table(f"{title}: one contact, honestly measured", [row for row in told if row["honest"]], HONEST),
            _table(f"{title}: faults and other worlds", [row for row in told if not row["honest"]], FAULTS),
            _LEGEND,
            f"Rows that miss the goals: {'; '.join(missed) or 'none'}.",
        ],
    )


FIRST = {"samples": "samples", "error mm": "error_mm", "held": "held"}
SAID = {name: name for name in ("unexplained", "noted", "clear", "silent", "misleading")}
OTHER = {"unsteady": "held_unsteady", "other": "held_noted"}
HONEST = {**FIRST, **OTHER, **SAID, "ghosts": "ghosts", "interval mm": "interval_mm"}
"""The figures of a row under each heading."""
FAULTS = {**FIRST, **SAID, "noticed": "noticed", "power": "power"}


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


_LEGEND = """\
All shares are in percent, and of all samples unless another number is named.
held: intervals that hold the truth, of contacts without a note; unsteady, other: of those with this note, or another
silent: no answer, as too few channels are within their range; ghosts: contacts that begin again, of the draws
misleading: a contact without a note that is not there, or is further off than twice the half-interval
interval: the median, with or without a note
noticed: unexplained, or a contact with a note; power: of the test that knows what happened, at the same false rate"""
