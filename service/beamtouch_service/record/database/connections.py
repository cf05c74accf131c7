"""A database of the record: one connection that writes, others that read. It is prepared when it is reached."""

import sqlite3
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext

from sqlalchemy import Connection, Engine, event
from sqlalchemy.exc import DBAPIError, InterfaceError, OperationalError, SQLAlchemyError

from beamtouch_service.record.database.errors import RecordAwayError, RecordUnusableError, reason_of
from beamtouch_service.record.database.tables import OtherFormatError, is_current, prepare

READERS = 2
"""Threads that read, each with a connection of its own."""
_READ_ONLY = "25006"
"""The error code of a PostgreSQL standby, which takes writes once it is the primary."""


class Connections:
    """Connections that are used for one purpose, at most `pool_size` at once, and opened again if the file changes."""

    def __init__(
        self,
        engine: Engine,
        lock: AbstractContextManager[object] | None = None,
        identify: Callable[[], object] = lambda: None,
        on_replaced: Callable[[], None] = lambda: None,
    ) -> None:
        """Hold `lock` during each use. `on_replaced` is called once `identify` tells another file than before."""
        self.engine = engine
        self._lock, self._identify, self._on_replaced = lock or nullcontext(), identify, on_replaced
        self._opened: object = None
        """The database of the connections, as messages name it."""

    @contextmanager
    def use(self) -> Iterator[Connection]:
        """Give a connection; errors are those of the database."""
        if self._opened is not None and self._opened != self._identify():
            self._opened = None
            self._on_replaced()
            self.engine.dispose()
        with self._lock, self.engine.connect() as connection:
            self._opened = self._opened or self._identify()
            yield connection


class Database:
    """A database with a connection that writes, and others that only read. It is checked before its first use."""

    def __init__(self, writer: Connections, readers: Connections, where: str, remedy: str) -> None:
        """Prepare it, unless it is away; raises RecordUnusableError if it can never be used.

        Messages that it cannot be used say where it is, and name the remedy.
        """
        self._writer, self._readers, self._where, self._remedy = writer, readers, where, remedy
        self._is_prepared = False
        self.away_because = ""
        """Why it was away at first; empty if it was not."""
        event.listen(writer.engine, "connect", self._connected)
        try:
            with self.writing():
                pass
        except RecordUnusableError:
            self.close()
            raise
        except RecordAwayError as error:  # the next call tries again
            self.away_because = str(error)

    @contextmanager
    def writing(self) -> Iterator[Connection]:
        """Give a transaction, the only one that writes; raises RecordAwayError, and as it is what the block raises.

        Only one thread may use this.
        """
        with self._use_writer() as connection:
            self._require_room(connection)
            with connection.begin():
                self._limit(connection)
                self._lock(connection)
                yield connection

    @contextmanager
    def reading_as_writer(self) -> Iterator[Connection]:
        """Give the connection that writes, for reading; raises RecordAwayError. Only one thread may use this."""
        with self._use_writer() as connection:
            self._limit(connection)
            yield connection

    @contextmanager
    def _use_writer(self) -> Iterator[Connection]:
        is_first = not self._is_prepared
        try:
            with self._writer.use() as connection:
                if not self._is_prepared:
                    self._prepare(connection)
                    self._is_prepared, is_first = True, False
                yield connection
        except OtherFormatError as error:
            raise RecordUnusableError(self._with_remedy(str(error), self._remedy)) from None
        except (SQLAlchemyError, sqlite3.Error, OSError) as error:
            self._is_prepared = False
            reason = self._with_remedy(reason_of(error), self._remedy_of(error)) if is_first else reason_of(error)
            raise (RecordUnusableError if is_first and not _is_passing(error) else RecordAwayError)(reason) from None

    @contextmanager
    def reading(self) -> Iterator[Connection]:
        """Give a connection of its own to a thread that reads; raises RecordAwayError."""
        try:
            with self._readers.use() as connection:
                self._limit(connection)
                yield connection
        except (SQLAlchemyError, sqlite3.Error, OSError) as error:
            raise RecordAwayError(reason_of(error)) from None

    def _with_remedy(self, reason: str, remedy: str) -> str:
        return f"{self._where}: {reason}; {remedy}"

    def _remedy_of(self, _error: Exception) -> str:
        return self._remedy

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

    def _limit(self, connection: Connection) -> None:
        """Bound the times that a transaction may take, which begins with this."""

    def _require_room(self, connection: Connection) -> None:
        """Raise RecordAwayError if nothing may be written now."""

    def _lock(self, connection: Connection) -> None:
        """Make a transaction the only one that writes."""
        connection.exec_driver_sql("BEGIN IMMEDIATE")

    def _prepare(self, connection: Connection) -> None:
        if not is_current(connection):
            connection.rollback()
            with connection.begin():
                self._limit(connection)
                self._lock(connection)
                prepare(connection)
        connection.rollback()

    def _connected(self, _connection: sqlite3.Connection, _: object) -> None:
        # A database that was away may come back empty, or as another one.
        self._is_prepared = False


def _is_passing(error: Exception) -> bool:
    """Return whether the same call may succeed later."""
    cause = error.orig if isinstance(error, DBAPIError) else error
    is_away = isinstance(error, OperationalError | InterfaceError | OSError)
    return is_away or isinstance(cause, sqlite3.OperationalError) or code_of(error) == _READ_ONLY


def code_of(error: Exception) -> str | None:
    """Return the error code of PostgreSQL, if it has one."""
    return getattr(error.orig, "sqlstate", None) if isinstance(error, DBAPIError) else None
