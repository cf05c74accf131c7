"""False contacts and false stretches of `unexplained`, over what was asked: every mask of every shipped scene."""

import sys
from itertools import combinations
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))

from models.false_alarms import (
    Watched,
    false_contacts_per_day,
    false_stretches_of_contacts_per_day,
    false_stretches_per_day,
    surface,
)
from support.surfaces.example_scenes import SCENES

CONTACTS, STRETCHES = 1024, 8192
"""Sequences that are drawn."""


def run() -> list[dict[str, object]]:
    """Smallest and largest rate over the masks of each scene."""
    rows: list[dict[str, object]] = []
    for path in sorted(SCENES.glob("*.toml")):
        on = surface(path.stem)
        every = range(on.prior.channels)
        masks = [kept for size in range(1, len(every) + 1) for kept in combinations(every, size)]
        checked = [kept for kept in masks if len(kept) > 2]
        each = {
            "false contacts": [_contacts(on, kept) for kept in masks],
            "false stretches at rest": [false_stretches_per_day(on, kept, STRETCHES) for kept in checked],
            "false stretches of contacts": [
                false_stretches_of_contacts_per_day(on, kept, STRETCHES) for kept in checked
            ],
        }
        for what, found in each.items():
            if found:
                name = f"{path.stem}: {what}"
                rows.append(
                    {"name": name, "value": max(found), "unit": "over asked", "goal": "at most 1", "least": min(found)}
                )
    return rows


def _contacts(on: Watched, kept: tuple[int, ...]) -> float:
    return false_contacts_per_day(on, kept, CONTACTS) / on.thresholds.false_contacts_per_day


if __name__ == "__main__":
    for row in run():
        print("  ".join(f"{key} {value:.3g}" if isinstance(value, float) else f"{value}" for key, value in row.items()))
