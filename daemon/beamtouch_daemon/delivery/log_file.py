"""The file of the logs: chunks of samples in SQLite, bounded, and intact after a crash at any moment.

Every change has reached the disk when the call returns. All calls block; `LogStore` makes them in one thread. A damaged
file is set aside whole, and `sqlite3 FILE .recover` shows what is left in it.
"""

import sqlite3
import zlib
from collections.abc import Iterator, Sequence, Set
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, NamedTuple

from beamtouch_common.files import identity_of
from beamtouch_service.samples import Batch

APPLICATION_ID = 0x62746C31
"""Marks the file, and the version of its schema."""
JOURNAL_BYTES = 65_536
"""Initial length of the journal: several times what the deletion of a chunk needs, also while the disk is full."""
FEW_ROWS = 8
"""Rows whose deletion fits into that journal, however many samples each has."""
_HEAD = b"SQLite format 3\0"
"""Beginning of each file of SQLite."""
_SCHEMA = """CREATE TABLE chunk (
    id INTEGER PRIMARY KEY AUTOINCREMENT, surface TEXT NOT NULL, boot TEXT NOT NULL,
    first INTEGER NOT NULL, last INTEGER NOT NULL, bytes INTEGER NOT NULL, checksum INTEGER NOT NULL,
    content BLOB NOT NULL
)"""
_DAMAGE = {
    *(sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB),
    *(sqlite3.SQLITE_IOERR_READ, sqlite3.SQLITE_IOERR_CORRUPTFS),  # a bad sector
}


class LogFileError(Exception):
    """The file cannot be used now, or what was in it is lost; the text is one line for the log."""


class ForeignFileError(LogFileError):
    """The file is no log of this program: only another path helps."""


class Chunk(NamedTuple):
    """Samples in one row of the file, without a gap."""

    row: int
    first: int
    last: int


class LogFile:
    """The file; only one process can use it at a time. Raises LogFileError.

    Parameters
    ----------
    path : Created by `open` if it does not exist.
    max_bytes : Limit of all chunks together; beyond it the oldest are deleted.
    """

    def __init__(self, path: Path, max_bytes: int) -> None:
        self.rows: dict[int, int] = {}
        """Row -> length of its content, oldest first."""
        self._path = path
        self._max_bytes = max_bytes
        self._database: sqlite3.Connection | None = None
        self._identity: tuple[int, int] | None = None
        """Device and inode number of the open file."""

    @property
    def is_open(self) -> bool:
        """True if the file is open."""
        return self._database is not None

    def open(self) -> list[tuple[str, Chunk, Batch]]:
        """Open or create the file; return the chunks in it, oldest first.

        Each comes with its surface, and with the oldest chunk of the same surface and boot, as it was written.
        """
        try:
            with self._errors("opened"):
                return self._open()
        except LogFileError:
            self.close()
            raise

    def change(self, add: Sequence[tuple[str, Batch]], keep: Set[int]) -> list[int]:
        """Add a chunk for each batch of a surface, and delete the rows that are not in `keep`.

        Beyond the limit, the oldest rows are deleted too, perhaps new ones. Returns the rows that were added.
        """
        added: list[int] = []
        self._delete([row for row in self.rows if row not in keep])
        with self._use("written") as database:
            left = dict(self.rows)
            for surface, batch in add:
                columns = _columns(surface, batch)
                row = database.execute("INSERT INTO chunk VALUES (NULL, ?, ?, ?, ?, ?, ?, ?)", columns).lastrowid or 0
                added.append(row)
                left[row] = len(columns[-1])
            excess = sum(left.values()) - self._max_bytes
            while excess > 0:
                excess -= left.pop(next(iter(left)))
            gone = {*self.rows, *added} - left.keys()
            database.executemany("DELETE FROM chunk WHERE id = ?", [(row,) for row in gone])
        self.rows = left
        return added

    def _delete(self, rows: Sequence[int]) -> None:
        """Delete rows at once; on a full disk, where the journal has no room for so many, a few at a time."""
        most = len(rows)
        while rows:
            try:
                with self._use("written") as database:
                    database.executemany("DELETE FROM chunk WHERE id = ?", [(row,) for row in rows[:most]])
            except LogFileError as error:
                is_full = getattr(error.__cause__, "sqlite_errorcode", 0) == sqlite3.SQLITE_FULL
                if not is_full or most <= FEW_ROWS:
                    raise
                most = FEW_ROWS
            else:
                self.rows = {row: length for row, length in self.rows.items() if row not in rows[:most]}
                rows = rows[most:]

    def read(self, row: int) -> Batch | None:
        """Return a chunk as it was written; None if it was deleted meanwhile, beyond the limit."""
        with self._use("read") as database:
            return _read(database, row) if row in self.rows else None

    def close(self) -> None:
        """Close the file."""
        if self._database is not None:
            self._database.close()
            self._database = None

    def _open(self) -> list[tuple[str, Chunk, Batch]]:
        self._require_own()
        self._database = database = sqlite3.connect(self._path, timeout=1.0)
        database.text_factory = lambda text: text.decode(errors="replace")
        database.execute("PRAGMA locking_mode = EXCLUSIVE")
        (mark,), tables = database.execute("PRAGMA application_id").fetchone(), "SELECT count(*) FROM sqlite_master"
        if mark != APPLICATION_ID and database.execute(tables).fetchone() != (0,):
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
        with suppress(OSError), Path(f"{self._path}-journal").open("ab") as journal:
            journal.write(bytes(max(0, JOURNAL_BYTES - journal.tell())))
        self._identity = identity_of(self._path)
        rows = database.execute("SELECT id, bytes, first, last, surface, boot FROM chunk ORDER BY id").fetchall()
        examples: dict[tuple[str, str], Batch] = {}
        for row, *_, surface, boot in rows:
            if (surface, boot) not in examples:
                examples[surface, boot] = _read(database, row)
        self.rows = {row: int(length) for row, length, *_ in rows}
        return [
            (surface, Chunk(row, int(first), int(last)), examples[surface, boot])
            for row, _, first, last, surface, boot in rows
        ]

    def _require_own(self) -> None:
        """Raise ForeignFileError if the file never was a log: a path given by mistake must not cost a file its name."""
        # A log that was damaged still has its journal beside it.
        if not self._path.is_file() or Path(f"{self._path}-journal").exists():
            return
        with self._path.open("rb") as file:
            head = file.read(len(_HEAD))
        # Damage, too, may have zeroed it or cut it off.
        if head.strip(b"\0") and not _HEAD.startswith(head):
            raise ForeignFileError(f"{self._path} is not a log; choose another file")

    @contextmanager
    def _use(self, doing: str) -> Iterator[sqlite3.Connection]:
        """Use the open file in a transaction."""
        if self._database is None:
            raise LogFileError(f"{self._path} is not open")
        if identity_of(self._path) != self._identity:
            self._lose()
            raise LogFileError(f"{self._path} was deleted or replaced while in use; the samples in it are lost")
        with self._errors(doing), self._database as database:
            yield database

    @contextmanager
    def _errors(self, doing: str) -> Iterator[None]:
        """Turn what SQLite raises into LogFileError, and set a damaged file aside."""
        try:
            yield
        except ValueError as error:  # a row is not as it was written
            raise self._set_aside(str(error).splitlines()[0]) from error
        except (sqlite3.Error, OSError) as error:
            code = getattr(error, "sqlite_errorcode", 0)
            if {code, code & 0xFF} & _DAMAGE:
                raise self._set_aside(str(error)) from error
            reason = "in use by another process" if code == sqlite3.SQLITE_BUSY else str(error)
            raise LogFileError(f"{self._path} cannot be {doing} ({reason})") from error

    def _lose(self) -> None:
        self.close()
        self.rows = {}

    def _set_aside(self, reason: str) -> LogFileError:
        """Rename a damaged file, in the place of one that was damaged before, and return what to say."""
        self._lose()
        aside, journal = Path(f"{self._path}.damaged"), Path(f"{self._path}-journal")
        try:
            journal.touch()
            journal.replace(f"{aside}-journal")
            self._path.replace(aside)
        except OSError as error:
            return LogFileError(f"{self._path} is damaged ({reason}) and cannot be renamed ({error.strerror})")
        return LogFileError(f"the file is damaged ({reason}); `sqlite3 {aside} .recover` shows what is left in it")


def _columns(surface: str, batch: Batch, content: bytes | None = None) -> tuple[Any, ...]:
    """Return the columns of a batch, without the number of the row."""
    content = batch.model_dump_json(exclude_defaults=True).encode() if content is None else content
    head = (surface, batch.boot_id, batch.samples[0].sequence, batch.samples[-1].sequence)
    return (*head, len(content), zlib.crc32(repr(head).encode() + content), content)


def _read(database: sqlite3.Connection, row: int) -> Batch:
    """Return the batch in a row; ValueError if it is not as it was written."""
    query = "SELECT surface, boot, first, last, bytes, checksum, content FROM chunk WHERE id = ?"
    columns = database.execute(query, (row,)).fetchone()
    content = columns[-1]
    # SQLite keeps whatever type a column was given.
    batch = Batch.model_validate_json(content) if isinstance(content, bytes) else None
    if batch is None or _columns(columns[0], batch, content) != columns:
        raise ValueError("a checksum does not match")
    return batch
