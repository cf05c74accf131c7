"""The database of the record: a SQLite file, memory, or PostgreSQL. Prepared when it is reached."""

import json
import logging
import os
import sqlite3
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from threading import Lock

from sqlalchemy import URL, Connection, Engine, StaticPool, create_engine, event, func, make_url, select
from sqlalchemy.exc import ArgumentError, DBAPIError, InterfaceError, OperationalError, SQLAlchemyError

from beamtouch_service.events.tables import EVENTS, OtherFormatError, is_current, prepare

_BUSY_S = 2.0
"""Wait this long while another program, such as a backup, has the file locked."""
_PRAGMAS = ("journal_mode=WAL", "synchronous=FULL", "foreign_keys=ON", "journal_size_limit=4194304")
_CONNECT: dict[str, object] = {
    "application_name": "beamtouch-service",
    "connect_timeout": 3,
    # A database whose machine or network is gone is noticed within about ten seconds.
    "tcp_user_timeout": 10_000,
    "keepalives_idle": 4,
    "keepalives_interval": 2,
    "keepalives_count": 3,
    # A service that is frozen in the middle of a transaction keeps the others waiting no longer than this.
    "options": "-c lock_timeout=4s -c statement_timeout=20s -c idle_in_transaction_session_timeout=5s",
}
"""Parameters of a connection, unless the URL has others."""
_LOCK = 0x6265616D
"""The advisory lock of a transaction that writes: "beam". Services write in turn."""
_READ_ONLY = "25006"
"""The error code of a standby, which takes writes once it is the primary."""
_ROW_BYTES = 400
"""Size of a row of PostgreSQL with its index entries, without its JSON."""

_log = logging.getLogger("beamtouch.service.events")
_compact_json = partial(json.dumps, separators=(",", ":"), allow_nan=False)


class EventsAwayError(Exception):
    """The record takes nothing now; the message gives its reason, in one line. What failed can be tried again."""


class EventStoreError(EventsAwayError):
    """The record cannot be used as it is; the message gives the reason and the remedy, in one line."""


class Database(ABC):
    """A database whose every connection is checked before its first use."""

    def __init__(self, engine: Engine) -> None:
        """Prepare it, unless it is away; raises EventStoreError if it can never be used."""
        self._engine = engine
        self._is_prepared = False
        self.away_because = ""
        """Why it was away at first; empty if it was not."""
        # A database that was away may come back empty, or as another one.
        event.listen(engine, "connect", self._connected)
        try:
            with self.writing():
                pass
        except EventStoreError:
            engine.dispose()
            raise
        except EventsAwayError as error:  # the next call tries again
            self.away_because = str(error)

    @contextmanager
    def writing(self) -> Iterator[Connection]:
        """Give a transaction, the only one that writes; raises EventsAwayError."""
        with self._connection() as connection, connection.begin():
            self._lock(connection)
            yield connection

    @contextmanager
    def reading(self) -> Iterator[Connection]:
        """Give a connection for reading; raises EventsAwayError."""
        with self._connection() as connection:
            yield connection

    def close(self) -> None:
        """Close the connections."""
        self._engine.dispose()

    @abstractmethod
    def used_bytes(self, connection: Connection) -> int:
        """Return the size of the events."""

    @abstractmethod
    def _lock(self, connection: Connection) -> None:
        """Make a transaction the only one that writes."""

    @abstractmethod
    def _described(self, reason: str) -> str:
        """Return why it cannot be used, with a remedy."""

    @contextmanager
    def _connection(self) -> Iterator[Connection]:
        is_first = not self._is_prepared
        try:
            with self._engine.connect() as connection:
                if not self._is_prepared:
                    self._prepare(connection)
                    self._is_prepared, is_first = True, False
                yield connection
        except OtherFormatError as error:
            raise EventStoreError(self._described(str(error))) from None
        except (SQLAlchemyError, sqlite3.Error, OSError) as error:
            self._is_prepared = False
            reason = self._described(_reason(error)) if is_first else _reason(error)
            raise (EventStoreError if is_first and not _is_passing(error) else EventsAwayError)(reason) from None

    def _prepare(self, connection: Connection) -> None:
        if not is_current(connection):
            connection.rollback()
            with connection.begin():
                self._lock(connection)
                prepare(connection)
        connection.rollback()

    def _connected(self, _connection: object, _: object) -> None:
        self._is_prepared = False


class FileDatabase(Database):
    """A SQLite file, which other programs may read. Several services may write to it."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._identity: tuple[int, int] | None = None
        """Device and inode of the open file."""
        arguments = {"check_same_thread": False, "isolation_level": None, "timeout": _BUSY_S}
        url = URL.create("sqlite", database=str(path))
        super().__init__(create_engine(url, json_serializer=_compact_json, connect_args=arguments))

    def used_bytes(self, connection: Connection) -> int:
        """Return the size of the used part of the file; later events fill the unused part first."""
        return _used_bytes(connection)

    @contextmanager
    def _connection(self) -> Iterator[Connection]:
        if self._identity is not None and self._identity != _identity(self._path):
            words = "the file of events was deleted or replaced while open; the record goes on in %s"
            _log.error(words, self._path)
            self._identity = None
            self._engine.dispose()
        with super()._connection() as connection:
            self._identity = self._identity or _identity(self._path)
            yield connection

    def _connected(self, connection: object, _: object) -> None:
        super()._connected(connection, _)
        for pragma in _PRAGMAS:
            connection.execute(f"PRAGMA {pragma}")  # type: ignore[attr-defined]  # the driver's

    def _lock(self, connection: Connection) -> None:
        connection.exec_driver_sql("BEGIN IMMEDIATE")

    def _described(self, reason: str) -> str:
        return f"events file {self._path}: {reason}; set events.file to one that the service can write"


class MemoryDatabase(Database):
    """A database in memory: one connection, for one thread at a time."""

    def __init__(self) -> None:
        self._turn = Lock()
        arguments = {"check_same_thread": False, "isolation_level": None}
        super().__init__(create_engine("sqlite://", poolclass=StaticPool, connect_args=arguments))

    def used_bytes(self, connection: Connection) -> int:
        """Return the size of the used part of the database."""
        return _used_bytes(connection)

    @contextmanager
    def _connection(self) -> Iterator[Connection]:
        with self._turn, super()._connection() as connection:
            yield connection

    def _lock(self, connection: Connection) -> None:
        connection.exec_driver_sql("BEGIN IMMEDIATE")

    def _described(self, reason: str) -> str:
        return reason


class ServerDatabase(Database):
    """A PostgreSQL database, which several services share."""

    def __init__(self, url: str) -> None:
        try:
            parsed = make_url(url).set(drivername="postgresql+psycopg")
        except (ArgumentError, ValueError):
            # Not quoted: it may hold a password.
            message = "events.url cannot be read; it looks like postgresql://beamtouch@127.0.0.1/beamtouch"
            raise EventStoreError(message) from None
        given = {name: value for name, value in _CONNECT.items() if name not in parsed.query}
        try:
            engine = create_engine(parsed, json_serializer=_compact_json, connect_args=given, pool_pre_ping=True)
        except ModuleNotFoundError:
            message = "events.url needs psycopg; run: pip install 'beamtouch[postgresql]'"
            raise EventStoreError(message) from None
        super().__init__(engine)

    def used_bytes(self, connection: Connection) -> int:
        """Return the size of the rows. The files of the database keep the room of deleted ones."""
        texts = (EVENTS.c.path, EVENTS.c.best, EVENTS.c.capture)
        sizes = sum((func.coalesce(func.pg_column_size(text), 0) for text in texts), start=0)
        return int(connection.scalar(select(func.coalesce(func.sum(sizes + _ROW_BYTES), 0))) or 0)

    def _lock(self, connection: Connection) -> None:
        connection.execute(select(func.pg_advisory_xact_lock(_LOCK)))

    def _described(self, reason: str) -> str:
        return f"the database of events.url: {reason}; give Beamtouch a database of its own"


def opened(place: Path | str | None) -> Database:
    """Open a file, the database of a URL, or memory; raises EventStoreError."""
    if place is None:
        return MemoryDatabase()
    return ServerDatabase(place) if isinstance(place, str) else FileDatabase(place)


def _identity(path: Path) -> tuple[int, int] | None:
    try:
        found = os.stat(path)  # noqa: PTH116  # a third of the time of Path.stat, at each use
    except OSError:
        return None
    return found.st_dev, found.st_ino


def _used_bytes(connection: Connection) -> int:
    pages, free, size = (
        int(connection.exec_driver_sql(f"PRAGMA {name}").scalar_one())
        for name in ("page_count", "freelist_count", "page_size")
    )
    return (pages - free) * size


def _is_passing(error: Exception) -> bool:
    """Return whether the same call may succeed later."""
    cause = error.orig if isinstance(error, DBAPIError) else error
    is_away = isinstance(error, OperationalError | InterfaceError | OSError)
    return is_away or isinstance(cause, sqlite3.OperationalError) or getattr(cause, "sqlstate", None) == _READ_ONLY


def _reason(error: Exception) -> str:
    found = error.orig if isinstance(error, DBAPIError) else error
    return (str(found).strip().splitlines() or [type(found).__name__])[0]
