"""Batches that could not be delivered, on disk: bounded, and as they were after a crash at any moment.

An SQLite database in one file. A batch is in it or is not, whenever the process or the machine dies: every change is a
transaction that has reached the disk when the call returns. All calls block; the publisher makes them in a thread.
"""

import sqlite3
import time
import uuid
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Self

from beamtouch_service.samples import Batch

BOOT_ID = Path("/proc/sys/kernel/random/boot_id")
MARGIN_S = 3600.0
"""A batch from before this boot of the machine is given out to be at least so much older than the boot."""

_SCHEMA = """
CREATE TABLE IF NOT EXISTS batch (
    id INTEGER PRIMARY KEY,
    surface TEXT NOT NULL,
    samples INTEGER NOT NULL,
    machine_boot TEXT NOT NULL,
    newest_monotonic_s REAL NOT NULL,
    content TEXT NOT NULL
);
CREATE INDEX IF NOT EXISTS by_surface ON batch (surface, id);
"""


class SpoolError(Exception):
    """The spool cannot be used now; the text is one line for the log."""


@dataclass(frozen=True, slots=True)
class Spooled:
    """A batch as it comes back."""

    number: int
    batch: Batch
    """With the age that its newest sample has now."""


class Spool:
    """The file; one process uses it at a time.

    Parameters
    ----------
    path
        Made if it is not there. One that is damaged is put aside, and a new one is made.
    most_bytes
        Of all batches together; beyond it the oldest are dropped and counted.

    Raises
    ------
    SpoolError
        It cannot be opened or made, or another process uses it.
    """

    def __init__(self, path: Path, most_bytes: int) -> None:
        self.waiting: Counter[str] = Counter()
        """Samples in it, by surface."""
        self.dropped: Counter[str] = Counter()
        """Samples that it had no room for, by surface."""
        self.put_aside: Path | None = None
        """Where a damaged file was moved to."""
        self._most_bytes = most_bytes
        # Where that cannot be seen, every start counts as another boot: ages then come out too great, never too small.
        self._machine_boot = BOOT_ID.read_text().strip() if BOOT_ID.exists() else str(uuid.uuid4())
        try:
            self._database = _opened(path)
        except sqlite3.DatabaseError as error:
            if _is_busy(error):
                message = f"{path} is in use by another process"
                raise SpoolError(message) from error
            if isinstance(error, sqlite3.OperationalError):
                message = f"{path} cannot be opened ({error}); name a file in a folder that can be written"
                raise SpoolError(message) from error
            self.put_aside = path.with_name(f"{path.name}.damaged-{int(time.time())}")
            path.rename(self.put_aside)
            self._database = _opened(path)
        for surface, samples in self._database.execute("SELECT surface, sum(samples) FROM batch GROUP BY surface"):
            self.waiting[surface] = samples
        (self._bytes,) = self._database.execute("SELECT coalesce(sum(length(content)), 0) FROM batch").fetchone()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._database.close()

    def put(self, surface: str, batch: Batch, newest_monotonic_s: float) -> None:
        """Add a batch behind all others of its surface, dropping the oldest of all where there is no room.

        Raises
        ------
        SpoolError
            It could not be written; nothing changed.
        """
        content = batch.model_dump_json()
        row = (surface, len(batch.samples), self._machine_boot, newest_monotonic_s, content)
        dropped: list[tuple[str, int, int]] = []
        try:
            with self._database:
                room = self._most_bytes - len(content)
                while self._bytes - sum(length for _, _, length in dropped) > room:
                    found = self._drop_oldest()
                    if found is None:
                        break
                    dropped.append(found)
                self._database.execute(
                    "INSERT INTO batch (surface, samples, machine_boot, newest_monotonic_s, content)"
                    " VALUES (?, ?, ?, ?, ?)",
                    row,
                )
        except sqlite3.DatabaseError as error:
            message = f"cannot write to the spool: {error}"
            raise SpoolError(message) from error
        self.waiting[surface] += len(batch.samples)
        self._bytes += len(content)
        for name, samples, length in dropped:
            self.waiting[name] -= samples
            self.dropped[name] += samples
            self._bytes -= length

    def oldest(self, surface: str) -> Spooled | None:
        """Return the oldest batch of a surface; None if there is none. SpoolError if it cannot be read."""
        try:
            row = self._database.execute(
                "SELECT id, machine_boot, newest_monotonic_s, content FROM batch WHERE surface = ? ORDER BY id LIMIT 1",
                (surface,),
            ).fetchone()
        except sqlite3.DatabaseError as error:
            message = f"cannot read the spool: {error}"
            raise SpoolError(message) from error
        if row is None:
            return None
        number, machine_boot, newest_monotonic_s, content = row
        batch = Batch.model_validate_json(content)
        age_s = max(0.0, time.monotonic() - newest_monotonic_s)
        if machine_boot != self._machine_boot:
            # Taken before this boot: by how much, only the wall clock knows, and that may have been set since.
            stated_s = time.time() - batch.samples[-1].acquired_unix_us / 1e6
            age_s = max(stated_s, time.monotonic() + MARGIN_S)
        return Spooled(number, batch.model_copy(update={"newest_age_ms": age_s * 1e3}))

    def remove(self, surface: str, spooled: Spooled) -> None:
        """Remove a batch that was delivered, or never can be. SpoolError if that fails; it comes again then."""
        try:
            with self._database:
                (length,) = self._database.execute(
                    "DELETE FROM batch WHERE id = ? RETURNING length(content)", (spooled.number,)
                ).fetchone()
        except sqlite3.DatabaseError as error:
            message = f"cannot write to the spool: {error}"
            raise SpoolError(message) from error
        self._bytes -= length
        self.waiting[surface] -= len(spooled.batch.samples)

    def _drop_oldest(self) -> tuple[str, int, int] | None:
        found: tuple[str, int, int] | None = self._database.execute(
            "DELETE FROM batch WHERE id = (SELECT min(id) FROM batch) RETURNING surface, samples, length(content)"
        ).fetchone()
        return found


def _opened(path: Path) -> sqlite3.Connection:
    database = sqlite3.connect(path, timeout=1.0, check_same_thread=False)
    try:
        database.execute("PRAGMA locking_mode = EXCLUSIVE")
        database.execute("PRAGMA journal_mode = WAL")
        database.execute("PRAGMA synchronous = FULL")
        with database:
            database.executescript(_SCHEMA)
        if database.execute("PRAGMA quick_check").fetchone() != ("ok",):
            message = "damaged"
            raise sqlite3.DatabaseError(message)
    except BaseException:
        database.close()
        raise
    return database


def _is_busy(error: sqlite3.Error) -> bool:
    return getattr(error, "sqlite_errorcode", None) == sqlite3.SQLITE_BUSY
