"""SQL statements of the spool. Each runs in its caller's transaction and may raise sqlite3 errors."""

import sqlite3
from collections import Counter
from collections.abc import Container
from typing import Any

from beamtouch_daemon.delivery.spool_row import NAME

Entry = tuple[int, bytes, int, int, bool]
"""Number, surface, samples and length of a batch, and whether it waits for delivery."""


def insert(database: sqlite3.Connection, number: int, row: tuple[Any, ...]) -> None:
    """Add a batch."""
    database.execute("INSERT INTO batch VALUES (?, ?, ?, ?, ?, ?, ?)", (number, *row))


def delete(database: sqlite3.Connection, number: int) -> int:
    """Delete a batch; return its length."""
    found = database.execute("SELECT length FROM entry WHERE id = ?", (number,)).fetchone()
    database.execute("DELETE FROM batch WHERE id = ?", (number,))
    database.execute("DELETE FROM aside WHERE id = ?", (number,))
    return found[0] if found else 0


def delete_oldest(database: sqlite3.Connection, excess: int) -> list[Entry]:
    """Delete the oldest batches of all surfaces until `excess` bytes are free; return them."""
    deleted: list[Entry] = []
    for entry in database.execute("SELECT id, name, samples, length, waits FROM entry ORDER BY id"):
        if excess <= 0:
            break
        deleted.append(entry)
        excess -= entry[3]
    for number, *_ in deleted:
        delete(database, number)
    return deleted


def next_number(database: sqlite3.Connection, surface: str, after: int) -> int | None:
    """Return the number of the oldest waiting batch of a surface above `after`; None if there is none."""
    query = "SELECT id FROM entry WHERE surface = ? AND id > ? AND waits ORDER BY id LIMIT 1"
    found = database.execute(query, (surface, after)).fetchone()
    return found[0] if found else None


def row(database: sqlite3.Connection, number: int) -> tuple[Any, ...] | None:
    """Return the columns of a batch without its number."""
    query = "SELECT surface, samples, machine_boot, newest_monotonic_s, content, checksum FROM batch WHERE id = ?"
    found: tuple[Any, ...] | None = database.execute(query, (number,)).fetchone()
    return found


def samples_of(database: sqlite3.Connection, number: int) -> int:
    """Return the number of samples of a batch: 1 if its count is damaged, 0 if it is gone."""
    found = database.execute("SELECT samples FROM entry WHERE id = ?", (number,)).fetchone()
    return found[0] if found else 0


def set_aside(database: sqlite3.Connection, number: int, reason: str) -> None:
    """Mark a batch as set aside, with the reason."""
    database.execute("INSERT OR REPLACE INTO aside VALUES (?, ?)", (number, reason))


def trim_aside(database: sqlite3.Connection, max_bytes: float) -> int:
    """Delete the oldest batches set aside beyond a size, but keep the newest; return the freed bytes."""
    query = "SELECT aside.id, length FROM aside CROSS JOIN entry ON entry.id = aside.id ORDER BY aside.id DESC"
    total = freed = 0
    for place, (number, length) in enumerate(database.execute(query).fetchall()):
        total += length
        if place and total > max_bytes:
            freed += delete(database, number)
    return freed


def set_nameless_aside(database: sqlite3.Connection, reason: str) -> int:
    """Set aside all batches whose surface has no valid name; return the number of their samples."""
    total = 0
    for (name,) in database.execute("SELECT DISTINCT name FROM entry").fetchall():
        if name is None or not NAME.fullmatch(name.decode(errors="replace")):
            query = "SELECT sum(samples) FROM entry WHERE name IS ? AND waits"
            total += database.execute(query, (name,)).fetchone()[0] or 0
            query = "INSERT INTO aside SELECT id, ? FROM entry WHERE name IS ? AND waits"
            database.execute(query, (reason, name))
    return total


def has_others(database: sqlite3.Connection, numbers: Container[int]) -> bool:
    """Whether the file has a batch with another number, waiting or set aside."""
    return any(number not in numbers for (number,) in database.execute("SELECT id FROM batch"))


def totals(database: sqlite3.Connection) -> tuple[int, int, Counter[str]]:
    """Return the bytes of all batches, the highest number, and the samples that wait, by surface."""
    size, last = database.execute("SELECT coalesce(sum(length), 0), coalesce(max(id), 0) FROM entry").fetchone()
    counts = database.execute("SELECT name, sum(samples) FROM entry WHERE waits GROUP BY name")
    return size, last, Counter({name.decode(): samples for name, samples in counts})
