"""A snapshot of a record in a file, while services write to it."""

import sqlite3
from contextlib import closing
from pathlib import Path

from beamtouch_service.record.database.errors import RecordAwayError, reason_of

_BUSY_S = 10.0


def copy_record(record: Path, copy: Path) -> None:
    """Copy a record as it is at one moment; raises RecordAwayError if it cannot be read, or is damaged.

    SQLite copies it in one read transaction, which holds up no writer.
    """
    try:
        uri = f"{record.absolute().as_uri()}?mode=rw"
        with closing(sqlite3.connect(uri, uri=True, timeout=_BUSY_S)) as source, closing(sqlite3.connect(copy)) as made:
            source.backup(made)
            made.execute("PRAGMA journal_mode=DELETE")
            (found,) = made.execute("PRAGMA quick_check(1)").fetchone()
    except sqlite3.Error as error:
        raise RecordAwayError(f"events file {record}: {reason_of(error)}") from None
    if found != "ok":
        raise RecordAwayError(f"events file {record}: damaged: {found}")
