"""Rescue of a damaged spool: the file is renamed, and every readable row goes into a new one."""

import sqlite3
from collections import Counter
from collections.abc import Iterator
from contextlib import closing, suppress
from pathlib import Path
from typing import Any

DAMAGED_FILES = 3
"""Number of damaged files to keep; older ones are deleted, as each may be as large as the spool."""
COLUMNS = 7
"""Columns of a batch, from its number to its checksum."""
_NUMBERS = (
    "SELECT id, surface FROM batch NOT INDEXED ORDER BY id",
    "SELECT id, surface FROM batch NOT INDEXED ORDER BY id DESC",
    "SELECT id, surface FROM batch INDEXED BY by_surface",
)
"""Both ends of the table, and its index; each is read up to the first damaged page."""


def put_aside(path: Path, stamp: int) -> Path:
    """Rename a damaged file and its journal; return the new path. Raises OSError."""
    aside = path.with_name(f"{path.name}.damaged-{stamp}")
    while aside.exists():
        stamp += 1
        aside = path.with_name(f"{path.name}.damaged-{stamp}")
    path.rename(aside)
    for tail in ("-journal", "-wal"):
        with suppress(FileNotFoundError):
            path.with_name(path.name + tail).rename(aside.with_name(aside.name + tail))
    databases = (found for found in path.parent.glob(f"{path.name}.damaged-*") if found.suffix[-1].isdigit())
    for old in sorted(databases, key=lambda found: found.stat().st_mtime)[:-DAMAGED_FILES]:
        for tail in ("", "-journal", "-wal"):
            old.with_name(old.name + tail).unlink(missing_ok=True)
    return aside


def put_back(aside: Path, path: Path) -> None:
    """Undo `put_aside`: the damaged file replaces the new one. Raises OSError."""
    for tail in ("-journal", "-wal", ""):
        path.with_name(path.name + tail).unlink(missing_ok=True)
        with suppress(FileNotFoundError):
            aside.with_name(aside.name + tail).rename(path.with_name(path.name + tail))


def rescue(damaged: Path, database: sqlite3.Connection, without: set[int]) -> Counter[str]:
    """Copy every readable row of a damaged file into a new one, except those with the numbers `without`.

    Returns
    -------
    Counter
        Number of rows that could not be copied, by surface; rows of unknown surfaces under an empty name.

    Raises
    ------
    sqlite3.DatabaseError
        The new file cannot be written; nothing was copied.
    """
    lost = Counter[str]()
    with database:
        for surface, row in _rows(damaged, without):
            try:
                database.execute("INSERT INTO batch VALUES (?, ?, ?, ?, ?, ?, ?)", row or ())
            except (sqlite3.IntegrityError, sqlite3.ProgrammingError):  # a value or the whole row is unreadable
                lost[surface] += 1
    return lost


def _rows(damaged: Path, without: set[int]) -> Iterator[tuple[str, tuple[Any, ...] | None]]:
    """Yield the surface and the columns of every row; None for columns that cannot be read."""
    with closing(sqlite3.connect(damaged)) as database:
        database.text_factory = _text
        with suppress(sqlite3.DatabaseError):
            database.execute("PRAGMA cell_size_check = ON")
        surfaces, aside = dict[int, str](), set[int]()
        for query in _NUMBERS:
            with suppress(sqlite3.DatabaseError):
                for number, surface in database.execute(query):
                    surfaces.setdefault(number, surface if isinstance(surface, str) else "")
        with suppress(sqlite3.DatabaseError):
            aside.update(number for (number,) in database.execute("SELECT id FROM aside"))
        for number in sorted(surfaces.keys() - aside - without):
            row = None
            with suppress(sqlite3.DatabaseError):
                row = database.execute("SELECT * FROM batch WHERE id = ?", (number,)).fetchone()
            # A file of an older version has no checksums.
            yield surfaces[number], row and (*row, None)[:COLUMNS]


def _text(content: bytes) -> str | bytes:
    try:
        return content.decode()
    except UnicodeDecodeError:
        return content
