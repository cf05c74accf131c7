"""The file of events stays where it belongs: one that was deleted or replaced while it is open is opened anew."""

import logging
from contextlib import suppress
from pathlib import Path
from sqlite3 import Error as SqliteError

from beamtouch_service.events.lock import WAIT_S
from beamtouch_service.events.store import EventStore, EventStoreError

_MOST_CARRIED = 1000
"""Events that are carried over into the file that is opened anew."""

_log = logging.getLogger("beamtouch.service.events")


class EventFile:
    """The store at a path, or in memory where there is none, or while that cannot be used."""

    def __init__(self, path: Path | None, keep_s: float, most_bytes: int, now_s: float) -> None:
        """Open it at `now_s` [s since 1970]; raises EventStoreError if the file cannot be used."""
        self._path, self._bounds = path, (keep_s, most_bytes)
        # Where the service is restarted, the former one may still be stopping.
        self.store = EventStore(path, *self._bounds, wait_s=WAIT_S)
        self._identity = self._found()
        """Of the file that is open; None for the memory."""
        self._seen_s = now_s
        """When it was in its place last."""

    def look_after(self, now_s: float) -> int:
        """See at `now_s` [s since 1970] that the path leads to what is open; return how many events that cost.

        Whoever deletes an open file takes its name only: what is written from then on nobody would ever find.
        """
        if self._path is None or (self._identity is not None and self._identity == self._found()):
            self._seen_s = now_s
            return 0
        former, was_file = self.store, self._identity is not None
        events, count = former.recorded_since(self._seen_s, _MOST_CARRIED)
        if was_file:
            # Before another is opened: SQLite finds the log beside a file by its name.
            _close(former)
        try:
            self.store = EventStore(self._path, *self._bounds)
        except EventStoreError as error:
            if not was_file:
                return 0
            _log.error("the file of events is gone, and events are kept in memory only: %s", error)
            self.store, self._identity = EventStore(None, *self._bounds), None
        else:
            self._identity = self._found()
            _log.warning("%s was deleted or replaced while it was open; it is opened anew", self._path)
            if not was_file:
                _close(former)
        with suppress(SqliteError):
            for event in events:
                self.store.write(event.surface, [event], now_s)
                count -= 1
        return count

    def close(self, now_s: float) -> int:
        """Close it at `now_s` [s since 1970], and say how many events are not on disk."""
        try:
            lost = self.look_after(now_s)
            if self._path is not None and self._identity is None:
                lost += self.store.recorded_since(0.0, 0)[1]
        finally:
            self.store.close()
        return lost

    def _found(self) -> tuple[int, int] | None:
        try:
            status = self._path.stat() if self._path else None
        except OSError:
            return None
        return (status.st_dev, status.st_ino) if status else None


def _close(store: EventStore) -> None:
    with suppress(SqliteError):
        store.close()
