"""The record in a SQLite file, or in memory."""

import logging
import sqlite3
from functools import partial
from pathlib import Path
from threading import Lock
from typing import TypedDict

from sqlalchemy import Connection, Engine, QueuePool, StaticPool, create_engine, event

from beamtouch_common.files import identity_of
from beamtouch_service.record.database.connections import READERS, Connections, Database
from beamtouch_service.record.database.errors import RecordAwayError
from beamtouch_service.record.database.values import JSON_CODEC
from beamtouch_service.record.database.write_ahead import WriteAheadLog

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

_log = logging.getLogger(__name__)


class _SqliteArguments(TypedDict):
    check_same_thread: bool
    isolation_level: None


_SQLITE: _SqliteArguments = {"check_same_thread": False, "isolation_level": None}


class MemoryDatabase(Database):
    """A database that ends with the process. It has one connection, for one thread at a time."""

    def __init__(self) -> None:
        engine = create_engine("sqlite://", poolclass=StaticPool, connect_args=_SQLITE, **JSON_CODEC)
        connections = Connections(engine, Lock())
        super().__init__(connections, connections, "events in memory", "start the service again")

    def _connected(self, connection: sqlite3.Connection, _: object) -> None:
        super()._connected(connection, _)
        connection.execute(_FOREIGN_KEYS)


class FileDatabase(Database):
    """A SQLite file, which other programs may read. Several services may write to it."""

    def __init__(self, path: Path) -> None:
        self._path, self._wal = path, WriteAheadLog(path)
        writer, reader = (f"{path.absolute().as_uri()}?mode={mode}" for mode in ("rwc", "rw"))
        identify = partial(identity_of, path)
        super().__init__(
            Connections(_file_engine(writer, 1), identify=identify, on_replaced=self._note_replaced),
            Connections(_file_engine(reader, READERS), identify=identify),
            f"events file {path}",
            "set events.file to one that the service can write",
        )
        event.listen(self._readers.engine, "connect", _only_read)

    def _require_room(self, connection: Connection) -> None:
        if reason := self._wal.reason_to_wait(connection):
            raise RecordAwayError(reason)

    def _note_replaced(self) -> None:
        words = "the file of events was deleted or replaced while open; the record goes on in %s"
        _log.error(words, self._path)

    def _connected(self, connection: sqlite3.Connection, _: object) -> None:
        super()._connected(connection, _)
        for pragma in _PRAGMAS:
            connection.execute(pragma)


def _file_engine(uri: str, connections: int) -> Engine:
    return create_engine(
        "sqlite://",
        creator=lambda: sqlite3.connect(uri, uri=True, timeout=_BUSY_S, **_SQLITE),
        poolclass=QueuePool,
        pool_size=connections,
        max_overflow=0,
        **JSON_CODEC,
    )


def _only_read(connection: sqlite3.Connection, _: object) -> None:
    connection.execute("PRAGMA query_only=ON")
