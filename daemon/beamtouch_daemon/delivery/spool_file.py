"""The SQLite file of the spool: opened for one process, and usable on a full disk.

A delete must need no new room, or a full disk could never be emptied. So the file has a rollback journal that keeps its
length, where a write-ahead log would have to grow. From the start the journal is long enough for a delete.
"""

import os
import sqlite3
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

JOURNAL_BYTES = 65_536
"""Initial length of the journal: several times what the removal of one batch needs."""
RESERVE_BYTES = 4_000_000
RESERVE_SHARE = 0.1
MIN_RESERVE_BYTES = 32_000
"""Reserved room for samples in memory when the daemon stops on a full disk: upper limit, share of the free room, lower
limit."""

_ASIDE = "TABLE IF NOT EXISTS aside (id INTEGER PRIMARY KEY, reason TEXT NOT NULL)"
_ENTRY = """VIEW IF NOT EXISTS entry AS SELECT
    id, CAST(surface AS BLOB) AS name, surface,
    CASE WHEN typeof(samples) = 'integer' AND samples BETWEEN 1 AND 2000 THEN samples ELSE 1 END AS samples,
    coalesce(length(CAST(content AS BLOB)), 0) AS length,
    id NOT IN (SELECT id FROM aside) AS waits
FROM batch"""
_SCHEMA = (
    """CREATE TABLE IF NOT EXISTS batch (
        id INTEGER PRIMARY KEY,
        surface TEXT NOT NULL,
        samples INTEGER NOT NULL,
        machine_boot TEXT NOT NULL,
        newest_monotonic_s REAL NOT NULL,
        content TEXT NOT NULL,
        checksum INTEGER
    )""",
    "CREATE INDEX IF NOT EXISTS by_surface ON batch (surface, id)",
    f"CREATE {_ASIDE}",
    f"CREATE {_ENTRY}",
)
"""Tables of batches and of those set aside, and a view that counts damaged rows too."""
_OWN = {b"batch", b"aside", b"entry"}
"""Tables and view of that schema."""
_DAMAGE = {
    *(sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB),
    *(sqlite3.SQLITE_IOERR_READ, sqlite3.SQLITE_IOERR_CORRUPTFS),  # a bad sector: the rest of the file can be rescued
}


class ForeignError(sqlite3.DatabaseError):
    """The file is the database of another program."""


class DamagedError(sqlite3.DatabaseError):
    """The file is damaged, in its structure or by a bad sector."""


def opened(path: Path) -> sqlite3.Connection:
    """Open or create the file. Texts come out as bytes, because a damaged text may not decode.

    A file of an older version has to be converted, which needs room. On a full disk it is opened for reading only, and
    `make_writable` converts it later.

    Raises
    ------
    DamagedError
        The file is no database, its structure is damaged, or a sector of it cannot be read.
    sqlite3.DatabaseError
        It cannot be opened or created.
    """
    database = sqlite3.connect(path, timeout=1.0, check_same_thread=False)
    try:
        database.text_factory = bytes
        for setting in ("locking_mode = EXCLUSIVE", "temp_store = MEMORY"):
            database.execute(f"PRAGMA {setting}")
        _require_own(database)
        try:
            _prepare(database, path)
        except sqlite3.DatabaseError as error:
            if getattr(error, "sqlite_errorcode", 0) != sqlite3.SQLITE_FULL or not _columns(database):
                raise
            _prepare_for_reading(database)
        found = database.execute("PRAGMA quick_check").fetchone()
        if found != (b"ok",):
            raise DamagedError(found[0].decode(errors="replace"))
    except sqlite3.DatabaseError as error:
        database.close()
        if is_damage(error) and not isinstance(error, DamagedError):
            raise DamagedError(*error.args) from error
        raise
    return database


def is_writable(database: sqlite3.Connection) -> bool:
    """Whether the file can be written: it has, or now got, the format of this version."""
    return not database.execute("SELECT name FROM temp.sqlite_master").fetchall()


def make_writable(database: sqlite3.Connection, path: Path) -> None:
    """Convert a file that was opened for reading only; sqlite3.DatabaseError while the disk is full."""
    aside = database.execute("SELECT id, reason FROM aside").fetchall()
    database.executescript("DROP VIEW temp.entry; DROP VIEW temp.batch; DROP TABLE temp.aside;")
    try:
        _prepare(database, path, aside)
    except sqlite3.DatabaseError:
        _prepare_for_reading(database, aside)
        raise


def _require_own(database: sqlite3.Connection) -> None:
    """Raise DatabaseError if this is the file of another program. A damaged spool may lack some of its tables."""
    names = {name for (name,) in database.execute("SELECT name FROM sqlite_master")}
    if names and names.isdisjoint(_OWN):
        message = "it is the database of another program"
        raise ForeignError(message)


def _prepare(database: sqlite3.Connection, path: Path, aside: Iterable[tuple[int, bytes]] = ()) -> None:
    """Give the file the format of this version, all of it or nothing; a file that has it is not written."""
    for setting in (
        "auto_vacuum = INCREMENTAL",
        "journal_mode = PERSIST",
        "synchronous = FULL",
        "secure_delete = OFF",
    ):
        database.execute(f"PRAGMA {setting}")
    with database:
        database.execute("BEGIN EXCLUSIVE")  # takes the lock and keeps it
        columns = _columns(database)
        if columns and b"checksum" not in columns:  # created by an older version
            database.execute("ALTER TABLE batch ADD COLUMN checksum INTEGER")
        for statement in _SCHEMA:
            database.execute(statement)
        database.executemany("INSERT INTO aside VALUES (?, ?)", aside)
    with suppress(OSError):  # without this room, deletes fail while the disk is full
        _lengthen(path.with_name(f"{path.name}-journal"), JOURNAL_BYTES)


def _prepare_for_reading(database: sqlite3.Connection, aside: Iterable[tuple[int, bytes]] = ()) -> None:
    """Put views in memory before the tables of an older version, so that it reads like one of this version."""
    database.execute("CREATE TEMP VIEW batch AS SELECT *, NULL AS checksum FROM main.batch")
    database.execute(f"CREATE TEMP {_ASIDE}")
    database.execute(f"CREATE TEMP {_ENTRY}")
    with database:
        database.executemany("INSERT INTO aside VALUES (?, ?)", aside)


def _columns(database: sqlite3.Connection) -> set[bytes]:
    """Return the names of the columns of the batches in the file; empty for a new file."""
    return {name for _, name, *_ in database.execute("PRAGMA main.table_info(batch)")}


def reserve(path: Path, max_bytes: int) -> None:
    """Reserve room beside the file, up to `max_bytes` and a tenth of the free room; do nothing if that fails."""
    ballast = _ballast(path)
    with suppress(OSError):
        disk = os.statvfs(path)
        size = min(RESERVE_BYTES, max_bytes, round(disk.f_bavail * disk.f_frsize * RESERVE_SHARE))
        if size >= MIN_RESERVE_BYTES and not ballast.exists():
            ballast.write_bytes(os.urandom(size))  # some file systems store no zeros


def release(path: Path) -> bool:
    """Release that room; return whether there was any."""
    try:
        _ballast(path).unlink()
    except OSError:
        return False
    return True


def _ballast(path: Path) -> Path:
    return path.with_name(f"{path.name}-reserve")


def is_damage(error: sqlite3.Error) -> bool:
    """Whether an error says that the file is damaged, in its structure or by a bad sector."""
    code = getattr(error, "sqlite_errorcode", 0)
    return isinstance(error, DamagedError) or bool({code, code & 0xFF} & _DAMAGE)


def _lengthen(path: Path, size: int) -> None:
    """Make a file at least `size` bytes long, with real content."""
    with path.open("ab") as file:
        file.write(bytes(max(0, size - file.tell())))
