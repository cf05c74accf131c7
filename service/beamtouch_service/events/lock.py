"""The lock on a file of events: one service writes to it at a time."""

import fcntl
import os
import time
from pathlib import Path

WAIT_S = 3.0
"""A service that is stopping gives its file up within this time: 2 s for answers under way, 1 s for writes."""
_LOOK_S = 0.05


class EventFileInUseError(Exception):
    """Another process has the file."""


class EventLock:
    """A lock on the file itself, whatever path leads to it; it ends with the process, also with a killed one.

    It is of another kind (flock) than the locks of SQLite (fcntl): other programs read the file as ever.
    """

    def __init__(self, path: Path, wait_s: float) -> None:
        """Take the lock on a file that exists, within `wait_s` [s].

        Raises
        ------
        EventFileInUseError
            Another process has it.
        OSError
            The file cannot be opened, or its file system knows no locks.
        """
        self._descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
        try:
            self._take(time.monotonic() + wait_s)
        except BaseException:
            self.close()
            raise

    def _take(self, end_s: float) -> None:
        while True:
            try:
                return fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                if time.monotonic() >= end_s:
                    raise EventFileInUseError from None
            time.sleep(_LOOK_S)

    def close(self) -> None:
        """Give it up; not before SQLite has closed the file, whose own locks end with any descriptor of it."""
        os.close(self._descriptor)
