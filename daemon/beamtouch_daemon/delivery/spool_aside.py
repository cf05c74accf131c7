"""Batches of the spool that are set aside, damaged or refused: they stay in the file for inspection, within a bound."""

import logging
import sqlite3
from contextlib import suppress

from beamtouch_daemon.delivery import spool_entries
from beamtouch_daemon.delivery.spool_connection import SpoolConnection, SpoolError
from beamtouch_daemon.delivery.spool_ledger import Ledger
from beamtouch_daemon.delivery.spool_row import BadRowError, Spooled, batch_of
from beamtouch_daemon.faults import Fault

SHARE = 0.1
"""Share of the spool for batches that are set aside; beyond it the oldest of them are deleted."""

_log = logging.getLogger(__name__)


class Aside:
    """Sets batches aside, and counts them in the ledger.

    Parameters
    ----------
    ledger
        The ledger of the spool.
    spool_bytes
        Limit of all batches together.
    """

    def __init__(self, ledger: Ledger, spool_bytes: int) -> None:
        self.max_bytes = round(SHARE * spool_bytes)
        """Limit of the batches that are set aside."""
        self._ledger = ledger
        self._fault = Fault(_log, "spool")

    def keep(self, file: SpoolConnection, surface: str, number: int, reason: str) -> None:
        """Set a batch aside. If the file cannot be written, note that in memory."""
        self._ledger.skipped.add(number)
        samples = 0
        with suppress(SpoolError), file.access("read") as database:
            samples = spool_entries.samples_of(database, number)
        self._ledger.was_set_aside(surface, samples)
        self._fault.failed(f"{surface}: a batch of {samples} samples is set aside: {reason}")
        with suppress(SpoolError):
            with file.access("write to") as database:
                spool_entries.set_aside(database, number, reason)
            with file.access("write to") as database:
                freed = spool_entries.trim_aside(database, self.max_bytes)
            self._ledger.bytes -= freed

    def keep_nameless(self, database: sqlite3.Connection) -> None:
        """Set all batches aside whose surface has no valid name; sqlite3.DatabaseError if that fails."""
        reason = "its surface has no valid name"
        with database:
            samples = spool_entries.set_nameless_aside(database, reason)
        if samples:
            self._ledger.set_aside[""] += samples
            self._fault.failed(f"{samples} samples are set aside: {reason}")

    def read(self, file: SpoolConnection, number: int, machine_boot: str) -> Spooled:
        """Return a batch; BadRowError if its row must be set aside, SpoolError if the file cannot be read."""
        with file.access("read") as database:
            row = spool_entries.row(database, number)
        if row is None:
            message = "the row is gone"
            raise BadRowError(message)
        return batch_of(row, number, machine_boot)
