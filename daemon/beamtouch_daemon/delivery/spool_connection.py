"""The connection to the spool's file. It reopens the file after an error and replaces a damaged file."""

import logging
import sqlite3
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from beamtouch_daemon.delivery import spool_file, spool_rescue

_log = logging.getLogger(__name__)


class SpoolError(Exception):
    """The spool cannot be used now; the text is one line for the log."""


class ForeignFileError(SpoolError):
    """The file belongs to another program: only another path helps."""


class SpoolConnection:
    """Transactions on the file. It may not be open or writable yet; each access tries again.

    Parameters
    ----------
    path
        Created if it does not exist.
    reserve_bytes
        Room to reserve on the disk, and to release when the disk is full.
    on_open
        Called after each opening, with the number of rows that were lost by damage, by surface.
    without
        Returns the numbers of rows that need not be rescued.
    on_gone
        Called if the file was deleted or replaced while it was in use; everything in it is lost.

    Raises
    ------
    ForeignFileError
        It is the file of another program.
    """

    def __init__(
        self,
        path: Path,
        reserve_bytes: int,
        on_open: Callable[[sqlite3.Connection, Counter[str]], None],
        without: Callable[[], set[int]],
        on_gone: Callable[[], None],
    ) -> None:
        self._path = path
        self._reserve_bytes = reserve_bytes
        self._on_open = on_open
        self._without = without
        self._on_gone = on_gone
        self._identity: tuple[int, int] | None = None
        """Device and inode number of the open file."""
        self._damage: str | None = None
        """Damage that was found while the file was in use."""
        self._database: sqlite3.Connection | None = None
        try:
            self._connect()
        except ForeignFileError:
            raise
        except SpoolError as error:  # new samples can still be delivered
            _log.error("%s; until it can be, undelivered samples are kept in memory", error)

    @property
    def is_open(self) -> bool:
        """Whether there is a connection; there is none until it can be opened, or once damage was found."""
        return self._database is not None

    @property
    def is_writable(self) -> bool:
        """Whether the file can be written; one of an older version can only be read while the disk is full."""
        return self._database is not None and spool_file.is_writable(self._database)

    def start_anew(self) -> None:
        """Delete the file and create a new one; SpoolError if that fails."""
        self.close()
        self._connect(anew=True)

    @contextmanager
    def access(self, doing: str) -> Iterator[sqlite3.Connection]:
        """Use the file in a transaction; SpoolError if it fails. A damaged file is replaced at the next access."""
        if self._database is not None and _identity_of(self._path) != self._identity:
            _log.error("%s was deleted or replaced while in use; the samples in it are lost", self._path)
            self.close()
            self._on_gone()
        database = self._database or self._connect()
        try:
            if doing != "read" and not spool_file.is_writable(database):
                spool_file.make_writable(database, self._path)
            with database:
                yield database
        except sqlite3.DatabaseError as error:
            if spool_file.is_damage(error):
                self._damage = str(error)
                self.close()
            message = f"cannot {doing} the spool: {error}"
            raise SpoolError(message) from error

    def reserve(self) -> None:
        """Reserve room on the disk, if there is any."""
        spool_file.reserve(self._path, self._reserve_bytes)

    def release(self) -> bool:
        """Release that room; return whether there was any."""
        return spool_file.release(self._path)

    def close(self) -> None:
        """Close the file."""
        if self._database is not None:
            self._database.close()
            self._database = None

    def _connect(self, *, anew: bool = False) -> sqlite3.Connection:
        try:
            for tail in ("", "-wal", "-journal") if anew else ():
                self._path.with_name(self._path.name + tail).unlink(missing_ok=True)
            database = self._opened()
        except (sqlite3.DatabaseError, OSError) as error:
            raise self._explained(error) from error
        self._database, self._identity = database, _identity_of(self._path)
        if not self.is_writable:
            _log.error("the disk is full; the older spool %s is delivered, but nothing is added to it", self._path)
        self.reserve()
        return database

    def _opened(self) -> sqlite3.Connection:
        """Open the file and count what is in it. A damaged one is replaced, or stays in place if that fails."""
        with ExitStack() as undo:
            try:
                if self._damage is not None:
                    raise spool_file.DamagedError(self._damage)
                database, lost = spool_file.opened(self._path), Counter[str]()
                undo.callback(database.close)
            except spool_file.DamagedError as error:
                aside = spool_rescue.put_aside(self._path, int(time.time()))
                undo.callback(spool_rescue.put_back, aside, self._path)
                database = spool_file.opened(self._path)
                undo.callback(database.close)
                lost = spool_rescue.rescue(aside, database, self._without())
                words = "the spool is damaged (%s); it is kept as %s, and its readable rows are in a new one"
                _log.error(words, error, aside)
            self._on_open(database, lost)
            undo.pop_all()
        self._damage = None
        return database

    def _explained(self, error: Exception) -> SpoolError:
        code = getattr(error, "sqlite_errorcode", None)
        if code == sqlite3.SQLITE_BUSY:
            return SpoolError(f"{self._path} is in use by another process")
        if code == sqlite3.SQLITE_FULL:
            return SpoolError(f"{self._path} cannot be created: the disk is full")
        kind = ForeignFileError if isinstance(error, spool_file.ForeignError) else SpoolError
        return kind(f"{self._path} cannot be opened ({error}); choose a file in a writable folder")


def _identity_of(path: Path) -> tuple[int, int] | None:
    """Return device and inode number of a file; None if it does not exist."""
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_dev, found.st_ino
