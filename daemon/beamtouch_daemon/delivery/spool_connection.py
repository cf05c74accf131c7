"""The connection to the spool's file: opened again after any error, and the file replaced when it is damaged."""

import logging
import sqlite3
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from beamtouch_daemon.delivery import spool_file, spool_rescue

_log = logging.getLogger(__name__)


class SpoolError(Exception):
    """The spool cannot be used now; the text is one line for the log."""


class SpoolFullError(SpoolError):
    """The disk has no room for a new spool."""


class SpoolConnection:
    """Transactions on the file.

    Parameters
    ----------
    path
        Made if it is not there.
    reserve_bytes
        Room to take on the disk, and to release when it is full.
    on_open
        Called when the file was opened, again after damage, with the numbers of rows that were lost, by surface.
    without
        Numbers of rows that need not be rescued.

    Raises
    ------
    SpoolError
        It cannot be opened or made, or another process uses it.
    """

    def __init__(
        self,
        path: Path,
        reserve_bytes: int,
        on_open: Callable[[sqlite3.Connection, Counter[str]], None],
        without: Callable[[], set[int]],
    ) -> None:
        self.put_aside: Path | None = None
        """Where a damaged file was moved to."""
        self._path = path
        self._reserve_bytes = reserve_bytes
        self._on_open = on_open
        self._without = without
        self._damage: str | None = None
        """What was found wrong with the file while it was in use."""
        self._database: sqlite3.Connection | None = None
        self._connect()

    @property
    def is_open(self) -> bool:
        """Whether there is a connection; there is none once the file was found to be damaged."""
        return self._database is not None

    @contextmanager
    def access(self, doing: str) -> Iterator[sqlite3.Connection]:
        """Use the file in a transaction; raises SpoolError. One that turns out to be damaged is replaced next time."""
        database = self._database or self._connect()
        try:
            with database:
                yield database
        except sqlite3.DatabaseError as error:
            if spool_file.is_damage(error):
                self._damage = str(error)
                self.close()
            message = f"cannot {doing} the spool: {error}"
            raise SpoolError(message) from error

    def reserve(self) -> None:
        """Take room on the disk, as far as there is any."""
        spool_file.reserve(self._path, self._reserve_bytes)

    def release(self) -> bool:
        """Release that room; return whether there was any."""
        return spool_file.release(self._path)

    def close(self) -> None:
        """Close the file."""
        if self._database is not None:
            self._database.close()
            self._database = None

    def _connect(self) -> sqlite3.Connection:
        database: sqlite3.Connection | None = None
        try:
            database, lost = self._opened()
            self._on_open(database, lost)
        except (sqlite3.DatabaseError, OSError) as error:
            if database is not None:
                database.close()
            raise self._explained(error) from error
        self._database = database
        self.reserve()
        return database

    def _opened(self) -> tuple[sqlite3.Connection, Counter[str]]:
        try:
            if self._damage is not None:
                raise spool_file.DamagedError(self._damage)
            return spool_file.opened(self._path), Counter()
        except spool_file.DamagedError as error:
            aside = self.put_aside = spool_rescue.put_aside(self._path, int(time.time()))
            self._damage = None
            words = "the spool is damaged (%s); it is kept as %s, and what can be read of it goes into a new one"
            _log.error(words, error, aside)
        database = spool_file.opened(self._path)
        try:
            return database, spool_rescue.rescue(aside, database, self._without())
        except BaseException:
            database.close()
            raise

    def _explained(self, error: Exception) -> SpoolError:
        code = getattr(error, "sqlite_errorcode", None)
        if code == sqlite3.SQLITE_BUSY:
            return SpoolError(f"{self._path} is in use by another process")
        if code == sqlite3.SQLITE_FULL:
            return SpoolFullError(f"{self._path} cannot be made: the disk is full")
        return SpoolError(f"{self._path} cannot be opened ({error}); name a file in a folder that can be written")
