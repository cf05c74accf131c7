"""The record in PostgreSQL, directly or through PgBouncer."""

from sqlalchemy import URL, Connection, Engine, create_engine, func, make_url, select
from sqlalchemy.exc import ArgumentError

from beamtouch_service.record.database.connections import READERS, Connections, Database, code_of
from beamtouch_service.record.database.errors import RecordUnusableError, reason_of
from beamtouch_service.record.database.tables import EVENTS
from beamtouch_service.record.database.values import JSON_CODEC

_CONNECT: dict[str, object] = {
    "application_name": "beamtouch-service",
    "connect_timeout": 3,
    # A database whose machine or network is gone is noticed within about ten seconds.
    "tcp_user_timeout": 10_000,
    "keepalives_idle": 4,
    "keepalives_interval": 2,
    "keepalives_count": 3,
    # PgBouncer may give each transaction another connection, which does not know what was prepared in this one.
    "prepare_threshold": None,
}
"""Parameters of a connection, unless the URL has others."""
_LIMITS = {"lock_timeout": "4s", "statement_timeout": "20s", "idle_in_transaction_session_timeout": "5s"}
"""Longest times of a transaction, unless the URL has `options`. A service that is frozen in the middle of one keeps the
others waiting no longer than this. They are set by each transaction, as PgBouncer refuses them with the connection."""
_PRIVILEGE = "42501"
"""The error code of what a role may not do."""
_LOCK = 0x6265616D
"""The advisory lock of a transaction that writes: "beam". Services write in turn."""
_ROW_BYTES = 450
"""Size of a row of PostgreSQL with its index entries, without its JSON (docs/figures.md)."""


class ServerDatabase(Database):
    """A PostgreSQL database, which several services share."""

    def __init__(self, url: str) -> None:
        try:
            parsed = make_url(url).set(drivername="postgresql+psycopg")
        except (ArgumentError, ValueError):
            # Not quoted: it may hold a password.
            message = "events.url cannot be read; it looks like postgresql://beamtouch@127.0.0.1/beamtouch"
            raise RecordUnusableError(message) from None
        try:
            writer, readers = (Connections(_server_engine(parsed, number)) for number in (1, READERS))
        except ModuleNotFoundError:
            raise RecordUnusableError("events.url needs psycopg; run: pip install 'beamtouch[postgresql]'") from None
        self._role = parsed.username or "this role"
        limits = {} if "options" in parsed.query else _LIMITS
        self._limits = select(*(func.set_config(name, value, True) for name, value in limits.items()))
        remedy = "check events.url, and that its server runs"
        super().__init__(writer, readers, "the database of events.url", remedy)

    def _remedy_of(self, error: Exception) -> str:
        reason, is_refused = reason_of(error), code_of(error) == _PRIVILEGE
        if is_refused and "schema" in reason:
            return f"let its owner run: GRANT CREATE ON SCHEMA public TO {self._role}"
        if is_refused:
            return f"the tables belong to another role: use that one in events.url, or give {self._role} a database"
        if "startup parameter: options" in reason:
            return "leave options out of events.url"
        if "statement pooling mode" in reason:
            return "set pool_mode = transaction in pgbouncer.ini"
        return self._remedy

    def _limit(self, connection: Connection) -> None:
        if self._limits.selected_columns:
            connection.execute(self._limits)

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


def _server_engine(url: URL, connections: int) -> Engine:
    given = {name: value for name, value in _CONNECT.items() if name not in url.query}
    return create_engine(
        url,
        **JSON_CODEC,
        connect_args=given,
        pool_pre_ping=True,
        pool_size=connections,
        max_overflow=0,
    )
