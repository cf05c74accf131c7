"""Batches that could not be delivered, on disk: bounded, and as they were after a crash at any moment.

An SQLite database in one file. A batch is in it or is not, whenever the process or the machine dies: every change is a
transaction that has reached the disk when the call returns. A row that does not hold its batch any more is set aside:
it stays in the file for a person to look at, and nothing waits for it. All calls block; `Disk` makes them in a thread.
"""

import logging
import sqlite3
import time
import uuid
from collections import Counter
from contextlib import suppress
from pathlib import Path
from typing import Any, Self

from beamtouch_daemon.delivery import spool_entries
from beamtouch_daemon.delivery.spool_connection import SpoolConnection, SpoolError
from beamtouch_daemon.delivery.spool_row import BadRowError, Spooled, batch_of, row_of
from beamtouch_daemon.faults import Fault
from beamtouch_service.samples import Batch

BOOT_ID = Path("/proc/sys/kernel/random/boot_id")
ASIDE_SHARE = 0.1
"""Of the spool's size, for batches that are set aside; beyond it the oldest of them are deleted."""
SWEEP_BATCHES = 500
"""Removed at once at most, so that one transaction stays small."""

_log = logging.getLogger(__name__)


class TooLargeError(SpoolError):
    """The batch alone is larger than the spool may be."""


class Spool:
    """The file; one process uses it at a time.

    Parameters
    ----------
    path
        Made if it is not there. One that is damaged is put aside, and what can be read of it goes into a new one.
    most_bytes
        Of all batches together; beyond it the oldest are dropped and counted.

    Raises
    ------
    SpoolError
        It cannot be opened or made, or another process uses it.
    """

    def __init__(self, path: Path, most_bytes: int) -> None:
        self.waiting: Counter[str] = Counter()
        """Samples in it that wait for delivery, by surface."""
        self.dropped: Counter[str] = Counter()
        """Samples that it had no room for, by surface."""
        self.set_aside: Counter[str] = Counter()
        """Samples that cannot be delivered and are kept for a person to look at, by surface."""
        self._most_bytes = most_bytes
        self._aside_fault = Fault(_log, "spool")
        self._done: set[int] = set()
        """Delivered, and still in the file: it could not be written yet."""
        self._skipped: set[int] = set()
        """Set aside; the file may not say so yet."""
        self._next = 1
        # Where that cannot be seen, every start counts as another boot: ages then come out too great, never too small.
        self._machine_boot = BOOT_ID.read_text().strip() if BOOT_ID.exists() else str(uuid.uuid4())
        self._bytes = 0
        self._file = SpoolConnection(
            path, round(ASIDE_SHARE * most_bytes), self._take_stock, lambda: self._done | self._skipped
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        with suppress(SpoolError):
            while self.sweep():
                pass
        self._file.close()

    @property
    def put_aside(self) -> Path | None:
        """Where a damaged file was moved to."""
        return self._file.put_aside

    @property
    def unremoved(self) -> int:
        """Batches that were delivered and are still in the file."""
        return len(self._done)

    def put(self, surface: str, batch: Batch, newest_monotonic_s: float, *, is_last: bool = False) -> int:
        """Add a batch behind all others of its surface, dropping the oldest of all where there is no room.

        Parameters
        ----------
        surface, batch
            What to keep.
        newest_monotonic_s
            When its last sample was taken, on the monotonic clock [s].
        is_last
            It has no other place to go: the room that is reserved on a full disk may be used.

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
        if (length := len(row[4])) > self._most_bytes:
            message = f"a batch of {length} bytes is larger than the spool"
            raise TooLargeError(message)
        try:
            self._insert(row, length)
        except SpoolError:
            if not is_last or not self._file.release():
                raise
            self._insert(row, length)
        self._next += 1
        self.waiting[surface] += len(batch.samples)
        return self._next - 1

    def put_refused(self, surface: str, batch: Batch, reason: str) -> None:
        """Keep a batch that the service will never take, for a person to look at. SpoolError if that fails."""
        number = self.put(surface, batch, max(0.0, time.monotonic() - batch.newest_age_ms / 1e3))
        self.keep_aside(surface, number, reason)

    def oldest(self, surface: str, after: int = 0) -> Spooled | None:
        """Return the oldest batch of a surface whose number is above `after`; None if there is none.

        Rows that do not hold their batch any more are set aside on the way. SpoolError if the file cannot be read.
        """
        while True:
            with self._file.access("read") as database:
                number = spool_entries.next_number(database, surface, after)
            if number is None:
                return None
            after = number
            if after in self._done or after in self._skipped:
                continue
            try:
                return self._read(after)
            except BadRowError as error:
                self.keep_aside(surface, after, str(error))

    def remove(self, surface: str, spooled: Spooled) -> None:
        """Forget a batch that was delivered: it does not come again, but after a crash before `sweep`."""
        self._done.add(spooled.number)
        self.waiting[surface] -= len(spooled.batch.samples)

    def sweep(self) -> int:
        """Delete batches that were delivered from the file; return how many. SpoolError if it cannot be written."""
        numbers = sorted(self._done)[:SWEEP_BATCHES]
        if not numbers:
            return 0
        with self._file.access("write to") as database:
            freed = [spool_entries.delete(database, number) for number in numbers]
        self._bytes -= sum(freed)
        self._done.difference_update(numbers)
        if not any(self.waiting.values()):
            with suppress(SpoolError), self._file.access("shrink") as database:  # the room is free for others again
                database.executescript("PRAGMA incremental_vacuum;")
            self._file.reserve()
        return len(numbers)

    def keep_aside(self, surface: str, number: int, reason: str) -> None:
        """Set a batch aside: it stays in the file, is not delivered, and is counted; where that fails, in memory."""
        self._skipped.add(number)
        samples = 0
        with suppress(SpoolError), self._file.access("read") as database:
            samples = spool_entries.samples_of(database, number)
        self.waiting[surface] -= samples
        self.set_aside[surface] += samples
        self._aside_fault.failed(f"{surface}: a batch of {samples} samples is set aside: {reason}")
        with suppress(SpoolError):
            with self._file.access("write to") as database:
                spool_entries.set_aside(database, number, reason)
            with self._file.access("write to") as database:
                freed = spool_entries.trim_aside(database, ASIDE_SHARE * self._most_bytes)
            self._bytes -= freed

    def _insert(self, row: tuple[Any, ...], length: int) -> None:
        with self._file.access("write to") as database:
            deleted = spool_entries.delete_oldest(database, self._bytes + length - self._most_bytes)
            spool_entries.insert(database, self._next, row)
        self._bytes += length
        for number, name, samples, freed, waits in deleted:
            self._bytes -= freed
            if waits and number not in self._done | self._skipped:
                self.waiting[name.decode()] -= samples
                self.dropped[name.decode()] += samples

    def _read(self, number: int) -> Spooled:
        """Return a batch; raises BadRowError, and SpoolError if the whole file cannot be read."""
        try:
            with self._file.access("read") as database:
                row = spool_entries.row(database, number)
        except SpoolError as error:
            if not self._file.is_open:  # damaged
                raise
            # One bad place on the disk is one bad row. A disk that is gone cannot be written either, and comes again.
            reason = f"it cannot be read ({error.__cause__})"
            with self._file.access("write to") as database:
                spool_entries.set_aside(database, number, reason)
            raise BadRowError(reason) from error
        if row is None:
            message = "the row is gone"
            raise BadRowError(message)
        return batch_of(row, number, self._machine_boot)

    def _take_stock(self, database: sqlite3.Connection, lost: Counter[str]) -> None:
        """Count what is in the file, and what it has lost."""
        before, reason = Counter(self.waiting), "its surface has no valid name"
        with database:
            nameless = spool_entries.set_nameless_aside(database, reason)
        if nameless:
            self.set_aside[""] += nameless
            self._aside_fault.failed(f"{nameless} samples are set aside: {reason}")
        self._bytes, last, waiting = spool_entries.totals(database)
        self._next = max(self._next, last + 1)
        self.waiting.clear()
        self.waiting.update(waiting)
        for surface in before | lost:
            self.set_aside[surface] += max(lost[surface], before[surface] - self.waiting[surface])
