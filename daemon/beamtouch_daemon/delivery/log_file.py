"""The file of the logs: chunks of samples in SQLite, bounded, and intact after a crash at any moment.

Every change has reached the disk when the call returns. All calls block; `LogStore` makes them in one thread. A damaged
file is set aside whole, and `sqlite3 FILE .recover` shows what is left in it.
"""

import logging
import sqlite3
import time
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, NamedTuple

from beamtouch_daemon.delivery.log import Chunk
from beamtouch_service.samples import Batch

APPLICATION_ID = 0x62746C31
"""Marks the file, and the version of its schema."""
JOURNAL_BYTES = 65_536
"""Initial length of the journal: several times what the deletion of a chunk needs, also while the disk is full."""
DAMAGED_FILES = 3
"""Limit of damaged files that are kept."""
_SCHEMA = """CREATE TABLE chunk (
    id INTEGER PRIMARY KEY AUTOINCREMENT, surface TEXT NOT NULL, boot TEXT NOT NULL,
    first INTEGER NOT NULL, last INTEGER NOT NULL, bytes INTEGER NOT NULL, checksum INTEGER NOT NULL,
    content BLOB NOT NULL
)"""
_DAMAGE = {
    *(sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB),
    *(sqlite3.SQLITE_IOERR_READ, sqlite3.SQLITE_IOERR_CORRUPTFS),  # a bad sector
}
_log = logging.getLogger(__name__)


class LogFileError(Exception):
    """The file cannot be used now; the text is one line for the log."""


class ForeignFileError(LogFileError):
    """The file belongs to another program: only another path helps."""


class LostFileError(LogFileError):
    """What was in the file is no longer there; the log says why."""


class _DamagedError(sqlite3.DatabaseError):
    """A row is not as it was written."""


class Entry(NamedTuple):
    """A chunk in the file, and the boot that it belongs to."""

    surface: str
    boot_id: str
    chunk: Chunk


class LogFile:
    """The file; only one process can use it at a time. Raises LogFileError.

    Parameters
    ----------
    path
        Created by `open` if it does not exist.
    max_bytes
        Limit of all chunks together; beyond it the oldest are deleted.
    """

    def __init__(self, path: Path, max_bytes: int) -> None:
        self._path = path
        self._max_bytes = max_bytes
        self._database: sqlite3.Connection | None = None
        self._identity: tuple[int, int] | None = None
        """Device and inode number of the open file."""
        self._bytes: dict[int, int] = {}
        """Row -> length of its content, oldest first."""

    @property
    def is_open(self) -> bool:
        """Whether the file is open."""
        return self._database is not None

    def open(self) -> list[Entry]:
        """Open or create the file; return the chunks in it, oldest first."""
        try:
            try:
                return self._open()
            except sqlite3.DatabaseError as error:
                if not _is_damage(error):
                    raise
                self._set_aside(str(error))
                return self._open()
        except (sqlite3.DatabaseError, OSError) as error:
            self.close()
            reason = "in use by another process" if _code(error) == sqlite3.SQLITE_BUSY else str(error)
            message = f"{self._path} cannot be opened ({reason})"
            raise LogFileError(message) from error

    def change(self, add: Sequence[tuple[str, Batch]], remove: Sequence[int]) -> tuple[list[int], list[int]]:
        """Add a chunk for each batch of a surface, and delete rows; without room, delete the oldest, too.

        Returns
        -------
        tuple
            The rows that were added, and the rows that were deleted for lack of room, perhaps some of the former.
        """
        rows = [_row_of(surface, batch) for surface, batch in add]
        removed = set(remove)
        left = {row: length for row, length in self._bytes.items() if row not in removed}
        added: list[int] = []
        with self._access("write to") as database:
            database.executemany("DELETE FROM chunk WHERE id = ?", [(row,) for row in remove])
            for columns in rows:
                cursor = database.execute("INSERT INTO chunk VALUES (NULL, ?, ?, ?, ?, ?, ?, ?)", columns)
                added.append(cursor.lastrowid or 0)
                left[added[-1]] = len(columns[-1])
            dropped = _excess(left, self._max_bytes)
            database.executemany("DELETE FROM chunk WHERE id = ?", [(row,) for row in dropped])
        self._bytes = {row: left[row] for row in list(left)[len(dropped) :]}
        return added, dropped

    def read(self, row: int) -> Batch:
        """Return a chunk as it was written."""
        query = "SELECT surface, boot, first, last, bytes, checksum, content FROM chunk WHERE id = ?"
        with self._access("read") as database:
            columns = database.execute(query, (row,)).fetchone()
        if columns is None:
            message = f"row {row} of {self._path} was deleted"
            raise LogFileError(message)
        try:
            batch = Batch.model_validate_json(columns[-1])
            if _row_of(columns[0], batch, columns[-1]) == columns:
                return batch
            reason = "a checksum does not match"
        except (TypeError, ValueError) as error:
            reason = str(error).splitlines()[0]
        self._set_aside(reason)
        raise LostFileError

    def close(self) -> None:
        """Close the file."""
        if self._database is not None:
            self._database.close()
            self._database = None

    def _open(self) -> list[Entry]:
        self._database = database = sqlite3.connect(self._path, timeout=1.0, check_same_thread=False)
        database.text_factory = lambda text: text.decode(errors="replace")
        database.execute("PRAGMA locking_mode = EXCLUSIVE")
        (mark,), tables = database.execute("PRAGMA application_id").fetchone(), "SELECT count(*) FROM sqlite_master"
        if mark != APPLICATION_ID and database.execute(tables).fetchone() != (0,):
            self.close()
            message = f"{self._path} is the database of another program or of another version; choose another file"
            raise ForeignFileError(message)
        # A journal that keeps its length: a deletion on a full disk needs no new room.
        for setting in ("journal_mode = PERSIST", "synchronous = FULL", "secure_delete = OFF"):
            database.execute(f"PRAGMA {setting}")
        with database:
            database.execute("BEGIN EXCLUSIVE")  # takes the lock and keeps it
            if mark != APPLICATION_ID:
                database.execute(f"PRAGMA application_id = {APPLICATION_ID}")
                database.execute(_SCHEMA)
        with suppress(OSError), self._path.with_name(f"{self._path.name}-journal").open("ab") as journal:
            journal.write(bytes(max(0, JOURNAL_BYTES - journal.tell())))
        self._identity = _identity_of(self._path)
        rows = database.execute("SELECT id, bytes, first, last, surface, boot FROM chunk ORDER BY id").fetchall()
        if not all(isinstance(number, int) for row in rows for number in row[:4]):
            message = "a number is none"
            raise _DamagedError(message)
        self._bytes = {row: length for row, length, *_ in rows}
        return [Entry(surface, boot, Chunk(row, first, last)) for row, _, first, last, surface, boot in rows]

    @contextmanager
    def _access(self, doing: str) -> Iterator[sqlite3.Connection]:
        """Use the file in a transaction."""
        if self._database is None:
            message = f"{self._path} is not open"
            raise LogFileError(message)
        if _identity_of(self._path) != self._identity:
            self.close()
            _log.error("%s was deleted or replaced while in use; the samples in it are lost", self._path)
            raise LostFileError
        try:
            with self._database as database:
                yield database
        except sqlite3.DatabaseError as error:
            if _is_damage(error):
                self._set_aside(str(error))
                raise LostFileError from error
            message = f"cannot {doing} {self._path}: {error}"
            raise LogFileError(message) from error

    def _set_aside(self, reason: str) -> None:
        """Rename a damaged file, and delete the oldest of those that were renamed before."""
        self.close()
        aside = self._path.with_name(f"{self._path.name}.damaged-{time.time_ns() // 1_000_000}")
        try:
            with suppress(FileNotFoundError):
                self._path.with_name(f"{self._path.name}-journal").rename(f"{aside}-journal")
            self._path.rename(aside)
        except OSError as error:
            message = f"{self._path} is damaged ({reason}) and cannot be renamed ({error.strerror})"
            raise LogFileError(message) from error
        _log.error("the log file is damaged (%s); `sqlite3 %s .recover` shows what is left in it", reason, aside)
        files = [path for path in self._path.parent.glob(f"{self._path.name}.damaged-*") if path.suffix[-1].isdigit()]
        for path in sorted(files)[:-DAMAGED_FILES]:
            path.unlink()
            path.with_name(f"{path.name}-journal").unlink(missing_ok=True)


def _row_of(surface: str, batch: Batch, content: bytes | None = None) -> tuple[Any, ...]:
    """Return the columns of a batch, without the number of the row."""
    content = batch.model_dump_json(exclude_defaults=True).encode() if content is None else content
    head = (surface, batch.boot_id, batch.samples[0].sequence, batch.samples[-1].sequence)
    return (*head, len(content), zlib.crc32(repr(head).encode() + content), content)


def _excess(left: dict[int, int], max_bytes: int) -> list[int]:
    """Return the oldest rows, which must go so that the others are within the limit."""
    excess, rows = sum(left.values()) - max_bytes, list[int]()
    for row, length in left.items():
        if excess <= 0:
            break
        rows.append(row)
        excess -= length
    return rows


def _identity_of(path: Path) -> tuple[int, int] | None:
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_dev, found.st_ino


def _code(error: Exception) -> int:
    return getattr(error, "sqlite_errorcode", 0)


def _is_damage(error: Exception) -> bool:
    return isinstance(error, _DamagedError) or bool({_code(error), _code(error) & 0xFF} & _DAMAGE)
