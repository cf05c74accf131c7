"""The SQLite file of the events: locked for this service, and upgraded when it is opened."""

import fcntl
import json
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path

from sqlalchemy import URL, Connection, StaticPool, create_engine, update
from sqlalchemy.exc import DBAPIError, OperationalError

from beamtouch_service.events.schema import EVENTS, FORMAT, IS_OPEN, number_changes, upgrade
from beamtouch_service.events.segments import End

_BUSY_S = 2.0
"""Wait this long while another program, such as a backup, has the file locked."""
_PRAGMAS = ("journal_mode=WAL", "synchronous=NORMAL", "journal_size_limit=4194304")


compact_json = partial(json.dumps, separators=(",", ":"))
"""JSON as it is stored."""


class EventStoreError(Exception):
    """The record cannot be used; the message gives the reason and the remedy, in one line."""


class EventsAwayError(Exception):
    """The database takes nothing now; the message gives its reason, in one line. What failed can be tried again."""


class EventFile:
    """A file, or a database in memory. A file that cannot be opened yet is opened by the call that can.

    The lock is on the file itself, whatever path leads to it, and ends with the process, even a killed one. It is an
    flock; SQLite's own locks are fcntl locks, so other programs can still read the file.
    """

    is_shared = False

    def __init__(self, path: Path | None) -> None:
        """Open the file, unless it is away; raises EventStoreError if it can never be used."""
        self._path = path
        self._lock: int | None = None
        self._is_open = False
        self._engine = create_engine(
            URL.create("sqlite", database=str(path) if path else None),
            poolclass=StaticPool,
            json_serializer=compact_json,
            json_deserializer=_kept_json,
            # The first write begins a transaction and takes SQLite's write lock at once; reads take none.
            connect_args={"check_same_thread": False, "isolation_level": "IMMEDIATE", "timeout": _BUSY_S},
        )
        with suppress(EventsAwayError):
            self._open()

    def _open(self) -> None:
        """Open the file if it is not open; raises EventsAwayError, and EventStoreError if it can never be used."""
        if self._is_open:
            return
        path = self._path
        try:
            # Connecting creates the file and reads nothing yet.
            with self._engine.connect() as connection:
                self._lock = _locked(path) if path else None
                _prepare(connection)
        except BlockingIOError:
            self._release()
            remedy = "stop that service, or give each a file of its own"
            message = f"events file {path}: another running service writes to it; {remedy}"
            raise EventsAwayError(message) from None
        except (DBAPIError, OSError, ValueError) as error:
            self._release()
            reason = str(error.orig if isinstance(error, DBAPIError) else getattr(error, "strerror", None) or error)
            message = f"events file {path}: {reason}; set events.file to one that the service can write"
            is_passing = isinstance(error, OperationalError | OSError)
            raise (EventsAwayError if is_passing else EventStoreError)(message) from None
        self._is_open = True

    @contextmanager
    def begin(self, _surface: str | None = None) -> Iterator[Connection]:
        """Give a transaction; the file has one lock for all surfaces. Raises EventsAwayError."""
        with self.connect() as connection, connection.begin():
            yield connection

    def connect(self) -> Connection:
        """Return a connection for reading; raises EventsAwayError."""
        try:
            self._open()
        except EventStoreError as error:
            raise EventsAwayError(str(error)) from None
        return self._engine.connect()

    def used_bytes(self) -> int:
        """Return the size of the used part of the file; later events fill the unused part first."""
        with self.connect() as connection:
            pages, free, size = (_pragma(connection, name) for name in ("page_count", "freelist_count", "page_size"))
        return (pages - free) * size

    def is_in_place(self) -> bool:
        """Return whether the path still leads to the open file."""
        if self._path is None or self._lock is None:
            return True
        with suppress(OSError):
            return os.path.samestat(self._path.stat(), os.fstat(self._lock))
        return False

    def close(self) -> None:
        """Mark open events as unfinished and close the file. If marking fails, the next service marks them."""
        if not self._is_open:
            return
        try:
            with self._engine.begin() as connection:
                connection.exec_driver_sql("PRAGMA busy_timeout=200")
                _finish(connection)
        finally:
            self._release()

    def abandon(self) -> None:
        """Do nothing: no call waits long for a file."""

    def abandon_stuck(self) -> None:
        """Do nothing, for the same reason."""

    def _release(self) -> None:
        # SQLite closes the file first: closing any descriptor of a file releases SQLite's locks on it.
        self._engine.dispose()
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None


def _kept_json(text: str) -> object:
    """Return what a text holds; nothing if it is damaged, as if another version had written it in another way."""
    try:
        return json.loads(text)
    except ValueError:
        return {}


def _prepare(connection: Connection) -> None:
    found = _pragma(connection, "user_version")
    # Before any statement that writes.
    if found == 0 and connection.exec_driver_sql("SELECT 1 FROM sqlite_master").first():
        message = "it is the database of another program"
        raise ValueError(message)
    connection.rollback()
    for pragma in _PRAGMAS:
        connection.exec_driver_sql(f"PRAGMA {pragma}")
    # The driver begins no transaction before statements that change tables.
    connection.exec_driver_sql("BEGIN IMMEDIATE")
    upgrade(connection, _pragma(connection, "user_version"))
    # The format is in the file's header, where older versions of the service look for it.
    connection.exec_driver_sql(f"PRAGMA user_version={FORMAT}")
    number_changes(connection)
    # The last service was stopped or killed during these.
    _finish(connection)
    connection.commit()


def _pragma(connection: Connection, name: str) -> int:
    return int(connection.exec_driver_sql(f"PRAGMA {name}").scalar_one())


def _finish(connection: Connection) -> None:
    connection.execute(update(EVENTS).where(IS_OPEN).values(end=End.UNFINISHED))


def _locked(path: Path) -> int:
    """Return a descriptor that holds the lock; raises BlockingIOError if another service has it."""
    descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BaseException:
        os.close(descriptor)
        raise
    return descriptor
