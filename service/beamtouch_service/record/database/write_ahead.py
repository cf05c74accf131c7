"""The write-ahead log of a SQLite file: it grows while another program holds on to an old state of the file."""

import logging
import os
from pathlib import Path

from sqlalchemy import Connection

from beamtouch_common.log_lines import Repeated

WARN_BYTES = 16_000_000
"""From this size on, the log names the reason: otherwise SQLite overwrites it from its start after about one MB."""
MAX_BYTES = 64_000_000
"""Beyond this size nothing is written: a full disk would cost more than events, which the daemons keep meanwhile."""
_log = logging.getLogger(__name__)


class WriteAheadLog:
    """The log beside a file. Only SQLite shortens it, once no program reads what is before its end."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._wal, self._index = (path.with_name(f"{path.name}-{what}") for what in ("wal", "shm"))
        self._hourly = Repeated(_log, every_s=3600.0)

    def reason_to_wait(self, connection: Connection) -> str:
        """Return why nothing may be written now; empty if it may. The connection is in no transaction.

        Writes a long log into the file first, as far as other programs allow, and warns of them once an hour.
        """
        size = _size(self._wal)
        if size <= WARN_BYTES:
            return ""
        # What is in the file already is overwritten by the next commit.
        _, pages, stored = connection.exec_driver_sql("PRAGMA wal_checkpoint(PASSIVE)").one()
        connection.rollback()  # the query has begun a transaction
        if pages == stored:
            return ""
        reason = f"{self._readers()} holds on to an old state of {self._path}, so its write-ahead log has "
        reason += f"{size / 1e6:.0f} MB; end that program, or its transaction"
        if size > MAX_BYTES:
            return reason
        if self._hourly.due("long"):
            _log.warning("the record of events: %s (beyond %.0f MB, nothing is written)", reason, MAX_BYTES / 1e6)
        return ""

    def _readers(self) -> str:
        """Return the programs that hold a lock on the index of the log, as far as the system tells."""
        try:
            inode = self._index.stat().st_ino
            lines = [line.split() for line in Path("/proc/locks").read_text().splitlines()]
            # As "1: POSIX ADVISORY READ 4711 08:01:131 123 123".
            held = {int(line[-4]) for line in lines if line[-3].rpartition(":")[2] == str(inode)} - {os.getpid()}
            names = [f"{Path(f'/proc/{pid}/comm').read_text().strip()} (process {pid})" for pid in sorted(held)]
        except (OSError, ValueError, IndexError):
            names = []
        return ", ".join(names) or "another program"


def _size(path: Path) -> int:
    try:
        return path.stat().st_size
    except OSError:
        return 0
