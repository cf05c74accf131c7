"""The spool keeps undelivered batches on disk: bounded, and intact after a crash at any moment.

It is one SQLite file. Every change is a transaction that has reached the disk when the call returns, so a crash of the
process or the machine leaves each batch either in the file or not. A damaged row is set aside: it stays in the file for
inspection, and delivery continues without it. All calls block; `Disk` makes them in a thread. It is written by hand
because no queue library bounds the size, survives a full disk and rescues rows of a damaged file.
"""

import sqlite3
import uuid
from collections import Counter
from contextlib import suppress
from pathlib import Path
from typing import Any, Self

from beamtouch_daemon.delivery import spool_entries
from beamtouch_daemon.delivery.spool_aside import Aside
from beamtouch_daemon.delivery.spool_connection import SpoolConnection, SpoolError
from beamtouch_daemon.delivery.spool_ledger import Ledger
from beamtouch_daemon.delivery.spool_row import BadRowError, Spooled, row_of
from beamtouch_daemon.uptime import uptime_s
from beamtouch_service.samples import Batch

BOOT_ID = Path("/proc/sys/kernel/random/boot_id")
SWEEP_BATCHES = 500
"""Limit of deletions in one transaction."""


class TooLargeError(SpoolError):
    """A single batch is larger than the whole spool."""


class Spool:
    """The spool file; only one process can use it at a time.

    Parameters
    ----------
    path
        Created if it does not exist. A damaged file is renamed, and its readable rows go into a new one.
    max_bytes
        Limit of all batches together; beyond it the oldest are dropped and counted.

    Raises
    ------
    SpoolError
        It is the file of another program. Anything else is tried again at each call.
    """

    def __init__(self, path: Path, max_bytes: int) -> None:
        self._ledger = Ledger()
        self.waiting, self.dropped = self._ledger.waiting, self._ledger.dropped
        self.set_aside = self._ledger.set_aside
        self._max_bytes = max_bytes
        self._aside = Aside(self._ledger, max_bytes)
        # Without this file, every start counts as another boot: ages are then too large, never too small.
        self._machine_boot = BOOT_ID.read_text().strip() if BOOT_ID.exists() else str(uuid.uuid4())
        self._file = SpoolConnection(
            path,
            self._aside.max_bytes,
            self._take_stock,
            lambda: self._ledger.over,
            self._ledger.lose_all,
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        with suppress(SpoolError):
            while self.sweep():
                pass
        self._file.close()

    @property
    def is_open(self) -> bool:
        """Whether the file is open; its disk may be full, or come later."""
        return self._file.is_open

    def open(self) -> None:
        """Open the file if it is not open. SpoolError if that is not possible now."""
        with self._file.access("open"):
            pass

    @property
    def unremoved(self) -> int:
        """Number of delivered batches that are still in the file."""
        return len(self._ledger.done)

    def put(self, surface: str, batch: Batch, newest_monotonic_s: float, *, is_last: bool = False) -> int:
        """Add a batch after all others of its surface; without room, drop the oldest batches of all surfaces.

        Parameters
        ----------
        surface, batch
            The batch and its surface.
        newest_monotonic_s
            Time of its last sample by the clock of `uptime_s` [s].
        is_last
            Whether the daemon is stopping, so that the room reserved on a full disk may be used.

        Returns
        -------
        int
            The number of the batch.

        Raises
        ------
        SpoolError
            It could not be written; nothing changed. TooLargeError if it never can be.
        """
        row = row_of(surface, batch, self._machine_boot, newest_monotonic_s)
        if (length := len(row[4])) > self._max_bytes:
            message = f"a batch of {length} bytes is larger than the spool"
            raise TooLargeError(message)
        try:
            self._insert(row, length)
        except SpoolError:
            if not is_last or not self._file.release():
                raise
            self._insert(row, length)
        return self._ledger.added(surface, len(batch.samples), length)

    def put_refused(self, surface: str, batch: Batch, reason: str) -> None:
        """Keep a batch for inspection that the service will never take. SpoolError if that fails."""
        number = self.put(surface, batch, max(0.0, uptime_s() - batch.newest_age_ms / 1e3))
        self.keep_aside(surface, number, reason)

    def oldest(self, surface: str, after: int = 0) -> Spooled | None:
        """Return the oldest batch of a surface whose number is above `after`; None if there is none.

        Damaged rows are set aside on the way. SpoolError if the file cannot be read.
        """
        while True:
            with self._file.access("read") as database:
                number = spool_entries.next_number(database, surface, after)
            if number is None:
                return None
            after = number
            if after in self._ledger.over:
                continue
            try:
                return self._aside.read(self._file, after, self._machine_boot)
            except BadRowError as error:
                self.keep_aside(surface, after, str(error))

    def remove(self, surface: str, spooled: Spooled) -> None:
        """Mark a batch as delivered. It only comes back after a crash before `sweep`."""
        self._ledger.delivered(surface, spooled.number, len(spooled.batch.samples))

    def sweep(self) -> int:
        """Delete delivered batches from the file; return their number. SpoolError if it cannot be written."""
        numbers = sorted(self._ledger.done)[:SWEEP_BATCHES]
        if not numbers:
            return 0
        try:
            with self._file.access("write to") as database:
                freed = [spool_entries.delete(database, number) for number in numbers]
        except SpoolError:
            if not self._start_anew():
                raise
            return len(numbers)
        self._ledger.swept(numbers, sum(freed))
        if not any(self.waiting.values()):
            with suppress(SpoolError), self._file.access("shrink") as database:  # frees the room for other programs
                database.executescript("PRAGMA incremental_vacuum;")
            self._file.reserve()
        return len(numbers)

    def keep_aside(self, surface: str, number: int, reason: str) -> None:
        """Set a batch aside: keep it in the file, undelivered. If the file cannot be written, note that in memory."""
        self._aside.keep(self._file, surface, number, reason)

    def _insert(self, row: tuple[Any, ...], length: int) -> None:
        with self._file.access("write to") as database:
            deleted = spool_entries.delete_oldest(database, self._ledger.bytes + length - self._max_bytes)
            spool_entries.insert(database, self._ledger.next, row)
        self._ledger.gave_way(deleted)

    def _start_anew(self) -> bool:
        """Replace a file that cannot be written if everything in it was delivered; return whether that was so."""
        with self._file.access("read") as database:
            if spool_entries.has_others(database, self._ledger.done):
                return False
        self._ledger.done.clear()
        self._file.start_anew()
        return True

    def _take_stock(self, database: sqlite3.Connection, lost: Counter[str]) -> None:
        """Count the batches in the file, and those that it lost."""
        self._aside.keep_nameless(database)
        self._ledger.take_stock(*spool_entries.totals(database), lost)
