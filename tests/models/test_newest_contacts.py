"""Which contacts of a file self-calibration takes: the newest ones, by their times, each event once."""

import csv
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from beamtouch_models.design.calibration.recordings import UnlabelledContacts, read_contacts
from beamtouch_models.runtime import ModelFile

BEGIN = datetime(2026, 11, 22, tzinfo=UTC)
MAX_CONTACTS, MORE = 2000, 25
UNIT_MM = 1e-5
"""The first channel of contact number n moves by n times this."""


def read(path: Path, model: ModelFile, rows: list[tuple[int, int, str]]) -> UnlabelledContacts:
    """Write contacts of these events, numbers and characteristics, and read them; the number gives the time."""
    ends = [f"{name}_{end}" for end in ("mm", "sd_mm") for name in model.channels]
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["event", "time", "model", "characteristic", *ends])
        for event, number, characteristic in rows:
            time = (BEGIN + timedelta(minutes=number)).isoformat(timespec="milliseconds").replace("+00:00", "Z")
            moved = [f"{number * UNIT_MM:.6f}", *["0.01"] * (len(model.channels) - 1)]
            writer.writerow([event, time, model.identity, characteristic, *moved, *["0.001"] * len(model.channels)])
    return read_contacts(path, model.metadata)


def numbers(contacts: UnlabelledContacts) -> list[int]:
    found: list[int] = np.rint(contacts.measured_mm[:, 0] / UNIT_MM).astype(int).tolist()
    return found


@pytest.mark.promise("docs/reference/loads.md", "`calibrate --events` uses the newest 2000 contacts")
@pytest.mark.parametrize("order", ["oldest first", "newest first", "mixed"])
def test_of_more_contacts_than_are_used_the_newest_count(tmp_path: Path, bench: ModelFile, order: str) -> None:
    rows = [(number, number, "a1") for number in range(MAX_CONTACTS + MORE)]
    if order == "newest first":
        rows.reverse()
    elif order == "mixed":
        rows = [rows[at] for at in np.random.default_rng(1).permutation(len(rows))]
    contacts = read(tmp_path / "contacts.csv", bench, rows)
    assert numbers(contacts) == list(range(MORE, MAX_CONTACTS + MORE))
    assert (contacts.older, contacts.other_characteristic) == (MORE, 0)


@pytest.mark.promise("docs/reference/loads.md", "that have the newest characteristic")
@pytest.mark.promise(
    "docs/how-to/calibrate-without-loads.md",
    "Contacts from before the last change of characteristic or tare are left out.",
)
def test_the_newest_characteristic_counts_whatever_comes_first_in_the_file(tmp_path: Path, bench: ModelFile) -> None:
    rows = [(number, number, "new" if number >= 30 else "old") for number in range(50)]
    for each in (rows, rows[::-1]):
        contacts = read(tmp_path / "contacts.csv", bench, each)
        assert numbers(contacts) == list(range(30, 50))
        assert (contacts.older, contacts.other_characteristic) == (0, 30)


def test_an_event_that_is_there_twice_counts_once(tmp_path: Path, bench: ModelFile) -> None:
    rows = [(number, number, "a1") for number in range(20)]
    assert numbers(read(tmp_path / "contacts.csv", bench, rows + rows[5:15])) == list(range(20))
