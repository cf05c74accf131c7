"""The database of the record: a SQLite file, memory, or PostgreSQL. Prepared when it is reached."""

import json
import logging
import os
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from functools import partial
from pathlib import Path
from threading import Lock
from typing import TypedDict

from sqlalchemy import URL, Connection, Engine, QueuePool, StaticPool, create_engine, event, func, make_url, select
from sqlalchemy.exc import ArgumentError, DBAPIError, InterfaceError, OperationalError, SQLAlchemyError

from beamtouch_service.events.tables import EVENTS, OtherFormatError, is_current, prepare
from beamtouch_service.events.write_ahead import WriteAheadLog

READERS = 2
"""Threads that read, each with a connection of its own."""
_BUSY_S = 2.0
"""Wait this long while another program, such as a backup, has the file locked."""
_FOREIGN_KEYS = "PRAGMA foreign_keys=ON"
_PRAGMAS = (
    "PRAGMA page_size=1024",
    "PRAGMA journal_mode=WAL",
    "PRAGMA synchronous=FULL",
    "PRAGMA journal_size_limit=4194304",
    _FOREIGN_KEYS,
)
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


class _SqliteArguments(TypedDict):
    check_same_thread: bool
    isolation_level: None


_SQLITE: _SqliteArguments = {"check_same_thread": False, "isolation_level": None}


class EventsAwayError(Exception):
    """The record takes nothing now; the message gives its reason, in one line. What failed can be tried again."""


class UnreadableRowError(EventsAwayError):
    """A row is damaged; the message gives the reason, in one line. Others may be whole."""


class EventStoreError(EventsAwayError):
    """The record cannot be used as it is; the message gives the reason and the remedy, in one line."""


class Connections:
    """Connections that are used for one purpose, at most `pool_size` at once, and opened anew if the file changes."""

    def __init__(
        self,
        engine: Engine,
        turn: AbstractContextManager[object] | None = None,
        identify: Callable[[], object] = lambda: None,
        on_replaced: Callable[[], None] = lambda: None,
    ) -> None:
        """Hold `turn` during each use. `on_replaced` is called once `identify` tells another file than before."""
        self.engine = engine
        self._turn, self._identify, self._on_replaced = turn or nullcontext(), identify, on_replaced
        self._opened: object = None
        """What the connections are of."""

    @contextmanager
    def use(self) -> Iterator[Connection]:
        """Give a connection; errors are those of the database."""
        if self._opened is not None and self._opened != self._identify():
            self._opened = None
            self._on_replaced()
            self.engine.dispose()
        with self._turn, self.engine.connect() as connection:
            self._opened = self._opened or self._identify()
            yield connection


class Database:
    """A database with a connection that writes, and others that only read. It is checked before its first use."""

    def __init__(self, writer: Connections, readers: Connections, place: str, remedy: str) -> None:
        """Prepare it, unless it is away; raises EventStoreError if it can never be used.

        Messages that it cannot be used name the place and the remedy.
        """
        self._writer, self._readers, self._place, self._remedy = writer, readers, place, remedy
        self._is_prepared = False
        self.away_because = ""
        """Why it was away at first; empty if it was not."""
        event.listen(writer.engine, "connect", self._connected)
        try:
            with self.writing():
                pass
        except EventStoreError:
            self.close()
            raise
        except EventsAwayError as error:  # the next call tries again
            self.away_because = str(error)

    @contextmanager
    def writing(self) -> Iterator[Connection]:
        """Give a transaction, the only one that writes; raises EventsAwayError. Only one thread may use this."""
        with self.loading() as connection:
            self._require_room(connection)
            with connection.begin():
                self._lock(connection)
                yield connection

    @contextmanager
    def loading(self) -> Iterator[Connection]:
        """Give the connection that writes, for reading; raises EventsAwayError. Only one thread may use this."""
        is_first = not self._is_prepared
        try:
            with self._writer.use() as connection:
                if not self._is_prepared:
                    self._prepare(connection)
                    self._is_prepared, is_first = True, False
                yield connection
        except OtherFormatError as error:
            raise EventStoreError(self._with_remedy(str(error))) from None
        except (ValueError, LookupError) as error:  # a damaged file may hold anything, and SQLite does not see it
            raise _unreadable(error) from None
        except (SQLAlchemyError, sqlite3.Error, OSError) as error:
            self._is_prepared = False
            reason = self._with_remedy(_reason(error)) if is_first else _reason(error)
            raise (EventStoreError if is_first and not _is_passing(error) else EventsAwayError)(reason) from None

    @contextmanager
    def reading(self) -> Iterator[Connection]:
        """Give a connection of its own to a thread that reads; raises EventsAwayError."""
        try:
            with self._readers.use() as connection:
                yield connection
        except (ValueError, LookupError) as error:
            raise _unreadable(error) from None
        except (SQLAlchemyError, sqlite3.Error, OSError) as error:
            raise EventsAwayError(_reason(error)) from None

    def _with_remedy(self, reason: str) -> str:
        return f"{self._place}: {reason}; {self._remedy}"

    def close(self) -> None:
        """Close the connections."""
        self._readers.engine.dispose()
        self._writer.engine.dispose()

    def used_bytes(self, connection: Connection) -> int:
        """Return the size of the used part of the file; later events fill the unused part first."""
        names = ("page_count", "freelist_count", "page_size")
        pages, free, size = (int(connection.exec_driver_sql(f"PRAGMA {name}").scalar_one()) for name in names)
        return (pages - free) * size

    def clock_s(self, _connection: Connection) -> float | None:
        """Return the wall clock of the database [s since 1970]; None if it has that of this machine."""
        return None

    def _require_room(self, connection: Connection) -> None:
        """Raise EventsAwayError if nothing may be written now."""

    def _lock(self, connection: Connection) -> None:
        """Make a transaction the only one that writes."""
        connection.exec_driver_sql("BEGIN IMMEDIATE")

    def _prepare(self, connection: Connection) -> None:
        if not is_current(connection):
            connection.rollback()
            with connection.begin():
                self._lock(connection)
                prepare(connection)
        connection.rollback()

    def _connected(self, _connection: sqlite3.Connection, _: object) -> None:
        # A database that was away may come back empty, or as another one.
        self._is_prepared = False


class MemoryDatabase(Database):
    """A database that ends with the process. It has one connection, for one thread at a time."""

    def __init__(self) -> None:
        engine = create_engine("sqlite://", poolclass=StaticPool, connect_args=_SQLITE)
        connections = Connections(engine, Lock())
        super().__init__(connections, connections, "events in memory", "start the service again")

    def _connected(self, connection: sqlite3.Connection, _: object) -> None:
        super()._connected(connection, _)
        connection.execute(_FOREIGN_KEYS)


class FileDatabase(Database):
    """A SQLite file, which other programs may read. Several services may write to it."""

    def __init__(self, path: Path) -> None:
        self._path, self._log = path, WriteAheadLog(path)
        writer, reader = (f"{path.absolute().as_uri()}?mode={mode}" for mode in ("rwc", "rw"))
        identify = partial(_identity, path)
        super().__init__(
            Connections(_file_engine(writer, 1), identify=identify, on_replaced=self._note_replaced),
            Connections(_file_engine(reader, READERS), identify=identify),
            f"events file {path}",
            "set events.file to one that the service can write",
        )
        event.listen(self._readers.engine, "connect", _only_read)

    def _require_room(self, connection: Connection) -> None:
        if reason := self._log.too_long(connection):
            raise EventsAwayError(reason)

    def _note_replaced(self) -> None:
        words = "the file of events was deleted or replaced while open; the record goes on in %s"
        _log.error(words, self._path)

    def _connected(self, connection: sqlite3.Connection, _: object) -> None:
        super()._connected(connection, _)
        for pragma in _PRAGMAS:
            connection.execute(pragma)


class ServerDatabase(Database):
    """A PostgreSQL database, which several services share."""

    def __init__(self, url: str) -> None:
        try:
            parsed = make_url(url).set(drivername="postgresql+psycopg")
        except (ArgumentError, ValueError):
            # Not quoted: it may hold a password.
            message = "events.url cannot be read; it looks like postgresql://beamtouch@127.0.0.1/beamtouch"
            raise EventStoreError(message) from None
        try:
            writer, readers = (Connections(_server_engine(parsed, number)) for number in (1, READERS))
        except ModuleNotFoundError:
            raise EventStoreError("events.url needs psycopg; run: pip install 'beamtouch[postgresql]'") from None
        remedy = "check events.url, and that its server runs"
        super().__init__(writer, readers, "the database of events.url", remedy)

    def used_bytes(self, connection: Connection) -> int:
        """Return the size of the rows. The files of the database keep the room of deleted ones."""
        texts = (EVENTS.c.path, EVENTS.c.best, EVENTS.c.capture)
        sizes = sum((func.coalesce(func.pg_column_size(text), 0) for text in texts), start=0)
        return int(connection.scalar(select(func.coalesce(func.sum(sizes + _ROW_BYTES), 0))) or 0)

    def clock_s(self, connection: Connection) -> float:
        """Return the wall clock of the database [s since 1970], which all services share."""
        return float(connection.scalar(select(func.extract("epoch", func.clock_timestamp()))) or 0.0)

    def _lock(self, connection: Connection) -> None:
        connection.execute(select(func.pg_advisory_xact_lock(_LOCK)))


def open_database(place: Path | str | None) -> Database:
    """Open a file, the database of a URL, or memory; raises EventStoreError."""
    if place is None:
        return MemoryDatabase()
    return ServerDatabase(place) if isinstance(place, str) else FileDatabase(place)


def _file_engine(uri: str, connections: int) -> Engine:
    return create_engine(
        "sqlite://",
        creator=lambda: sqlite3.connect(uri, uri=True, timeout=_BUSY_S, **_SQLITE),
        poolclass=QueuePool,
        pool_size=connections,
        max_overflow=0,
        json_serializer=_compact_json,
    )


def _only_read(connection: sqlite3.Connection, _: object) -> None:
    connection.execute("PRAGMA query_only=ON")


def _server_engine(url: URL, connections: int) -> Engine:
    given = {name: value for name, value in _CONNECT.items() if name not in url.query}
    return create_engine(
        url,
        json_serializer=_compact_json,
        connect_args=given,
        pool_pre_ping=True,
        pool_size=connections,
        max_overflow=0,
    )


def _identity(path: Path) -> tuple[int, int] | None:
    try:
        status = os.stat(path)  # noqa: PTH116  # a third of the time of Path.stat, at each use
    except OSError:
        return None
    return status.st_dev, status.st_ino


def _unreadable(error: Exception) -> UnreadableRowError:
    return UnreadableRowError(f"a row cannot be read: {_reason(error)}")


def _is_passing(error: Exception) -> bool:
    """Return whether the same call may succeed later."""
    cause = error.orig if isinstance(error, DBAPIError) else error
    is_away = isinstance(error, OperationalError | InterfaceError | OSError)
    return is_away or isinstance(cause, sqlite3.OperationalError) or getattr(cause, "sqlstate", None) == _READ_ONLY


def _reason(error: Exception) -> str:
    cause = error.orig if isinstance(error, DBAPIError) else error
    return (str(cause).strip().splitlines() or [type(cause).__name__])[0]
