"""The PostgreSQL database of the events: shared by several services, prepared when it is reached."""

import os
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from socket import SHUT_RDWR, socket

from sqlalchemy import Connection, Engine, create_engine, event, func, insert, inspect, make_url, select, text, update
from sqlalchemy.engine.interfaces import DBAPIConnection
from sqlalchemy.exc import ArgumentError, DBAPIError, InterfaceError, OperationalError

from beamtouch_service.events.file import EventsAwayError, EventStoreError, compact_json
from beamtouch_service.events.schema import CAPTURES, EVENTS, FORMAT, FORMATS, upgrade

_CONNECT: dict[str, object] = {
    "application_name": "beamtouch-service",
    "connect_timeout": 3,
    # A database whose machine or network is gone is noticed within about ten seconds.
    "tcp_user_timeout": 10_000,
    "keepalives_idle": 4,
    "keepalives_interval": 2,
    "keepalives_count": 3,
    # A service that is frozen in the middle of a transaction keeps the others waiting no longer than this.
    "options": "-c lock_timeout=4s -c statement_timeout=20s -c idle_in_transaction_session_timeout=8s",
}
"""Parameters of a connection, unless the URL has others."""
_LOCKS = 0x6265616D
"""The class of the advisory locks: "beam". The number in it is that of a surface, or 0 while tables are prepared."""
_ROW_BYTES = 400
"""Size of a row with its index entries, without its JSON."""
_CLOSED = -1
"""No socket."""
STUCK_S = 25.0
"""A call that takes longer is ended. PostgreSQL itself ends statements before that, unless it is frozen."""
_READ_ONLY = "25006"
"""The error code of a standby, which takes writes once it is the primary."""
_OTHER_TABLES = {"42P01", "42703"}
"""The error codes of a missing table and of a missing column: a backup was restored while the connection was open."""


class EventDatabase:
    """The events of several services. Each write is one transaction, and those of a surface are carried out in turn."""

    is_shared = True

    def __init__(self, url: str) -> None:
        """Prepare the tables, unless the database is away; raises EventStoreError if it can never be used."""
        self._engine = _engine(url)
        self._is_prepared = False
        # A database that was away may come back empty, or changed by a newer service.
        event.listen(self._engine, "connect", self._connected)
        event.listen(self._engine, "close", self._closing)
        self._socket = _CLOSED
        self._busy_since_s: float | None = None
        """Time at which the call that uses the connection began [s, monotonic]."""
        try:
            with self._engine.connect() as connection:
                self._prepare(connection)
        except EventStoreError:
            self.close()
            raise
        except DBAPIError as error:
            if not _is_passing(error):
                raise

    @contextmanager
    def begin(self, surface: str | None = None) -> Iterator[Connection]:
        """Give a transaction, the only one that writes to `surface`; raises EventsAwayError."""
        with self.connect() as connection, connection.begin():
            if surface is not None:
                _lock(connection, func.hashtext(surface))
            yield connection

    @contextmanager
    def connect(self) -> Iterator[Connection]:
        """Give a connection for reading; raises EventsAwayError."""
        try:
            with self._engine.connect() as connection:
                self._prepare(connection)
                self._busy_since_s = time.monotonic()
                yield connection
        except DBAPIError as error:
            if _code(error) in _OTHER_TABLES:
                self._is_prepared = False
            elif not _is_passing(error):
                raise
            raise EventsAwayError(_reason(error)) from None
        except EventStoreError as error:
            raise EventsAwayError(_reason(error)) from None
        finally:
            self._busy_since_s = None

    def used_bytes(self) -> int:
        """Return the size of the rows. The files of the database keep the room of deleted ones."""
        sizes = func.pg_column_size(EVENTS.c.path) + func.coalesce(func.pg_column_size(EVENTS.c.best), 0)
        events = select(func.coalesce(func.sum(sizes + _ROW_BYTES), 0))
        captures = select(func.coalesce(func.sum(func.pg_column_size(CAPTURES.c.sample) + _ROW_BYTES), 0))
        with self.connect() as connection:
            return int(connection.scalar(events) or 0) + int(connection.scalar(captures) or 0)

    def is_in_place(self) -> bool:
        """Return true: a database that is deleted takes its connections with it."""
        return True

    def close(self) -> None:
        """Close the connection. Open events may be those of another service."""
        self._engine.dispose()

    def abandon(self) -> None:
        """End a call of another thread that waits for the database, which may be frozen."""
        with suppress(OSError), socket(fileno=os.dup(self._socket)) as same:
            same.shutdown(SHUT_RDWR)

    def abandon_stuck(self) -> None:
        """End a call of another thread that has taken longer than `STUCK_S`."""
        since_s = self._busy_since_s
        if since_s is not None and time.monotonic() - since_s > STUCK_S:
            self.abandon()

    def _connected(self, connection: DBAPIConnection, _: object) -> None:
        self._is_prepared = False
        self._socket = connection.fileno()

    def _closing(self, _connection: DBAPIConnection, _: object) -> None:
        # Its number may soon be that of another socket.
        self._socket = _CLOSED

    def _prepare(self, connection: Connection) -> None:
        if not self._is_prepared:
            _prepare(connection)
            self._is_prepared = True


def _engine(url: str) -> Engine:
    try:
        parsed = make_url(url).set(drivername="postgresql+psycopg")
    except (ArgumentError, ValueError):
        # Not quoted: it may hold a password.
        message = "events.url cannot be read; it looks like postgresql://beamtouch@127.0.0.1/beamtouch"
        raise EventStoreError(message) from None
    given = {name: value for name, value in _CONNECT.items() if name not in parsed.query}
    try:
        return create_engine(parsed, pool_size=1, max_overflow=0, json_serializer=compact_json, connect_args=given)
    except ModuleNotFoundError:
        message = "events.url needs psycopg; run: pip install 'beamtouch[postgresql]'"
        raise EventStoreError(message) from None


def _prepare(connection: Connection) -> None:
    """Create or upgrade the tables. Several services may start at once."""
    try:
        with connection.begin():
            _lock(connection, 0)
            found = 0
            if inspect(connection).has_table(FORMATS.name):
                found = connection.scalar(select(FORMATS.c.format)) or 0
            if found == FORMAT:
                return
            # To change a large table takes its time; the other services wait.
            connection.execute(text("SET LOCAL statement_timeout = 0"))
            upgrade(connection, found)
            if found:
                connection.execute(update(FORMATS).values(format=FORMAT))
            else:
                FORMATS.create(connection)
                connection.execute(insert(FORMATS).values(format=FORMAT))
    except (DBAPIError, ValueError) as error:
        if isinstance(error, DBAPIError) and _is_passing(error):
            raise
        message = f"the database of events.url: {_reason(error)}; give Beamtouch a database of its own"
        raise EventStoreError(message) from None


def _lock(connection: Connection, number: object) -> None:
    connection.execute(select(func.pg_advisory_xact_lock(_LOCKS, number)))


def _is_passing(error: DBAPIError) -> bool:
    """Return whether the same call may succeed later."""
    is_away = isinstance(error, OperationalError | InterfaceError) or error.connection_invalidated
    return is_away or _code(error) == _READ_ONLY


def _code(error: DBAPIError) -> str | None:
    """Return the code that PostgreSQL gave the error; None if it came from elsewhere."""
    code: str | None = getattr(error.orig, "sqlstate", None)
    return code


def _reason(error: Exception) -> str:
    found = error.orig if isinstance(error, DBAPIError) else error
    return (str(found).strip().splitlines() or [type(found).__name__])[0]
