"""The one writer of the record: a thread with a connection of its own. It says when the record is away, and back."""

import logging
from collections.abc import Callable
from typing import TypeVar

from beamtouch_common.log import Repeated
from beamtouch_service.events.store import Store
from beamtouch_service.events.threads import Workers

_log = logging.getLogger("beamtouch.service.events")
_T = TypeVar("_T")


class Writer:
    """Writes one thing after another, in the order in which it is told to."""

    def __init__(self, store: Store) -> None:
        self.outages = 0
        """Times that the record went away."""
        self.reason = ""
        """Why the record is away; empty while it is there."""
        self._store, self._thread, self._fault = store, Workers("record"), Repeated(_log)
        self.note(store.away_because)

    async def run(self, call: Callable[[Store], _T]) -> _T:
        """Return what a call of the record gives; raises EventsAwayError. It may wait for what was begun before."""
        return await self._thread.run(lambda: call(self._store))

    def note(self, reason: str) -> None:
        """Log that the record went away for this reason, or with an empty one that it is back."""
        if reason and not self.reason:
            self.outages += 1
            self._fault.failed(f"the record of events is away: {reason}; answers go on, and daemons keep their samples")
        elif self.reason and not reason:
            self._fault.over("the record of events is back")
        self.reason = reason

    def note_unexpected(self, error: BaseException) -> None:
        """Note that the record is away for an error that no database is known to raise."""
        if self._fault.due(f"{error!r}"):
            _log.error("the record cannot be read or written", exc_info=error)
        self.note(f"unexpected error ({error!r})")

    def end(self) -> None:
        """End the thread after what was begun, and close the database."""
        # Nobody waits for it: a disk that does not answer must not hold up a stop.
        self._thread.post(self._store.close)
        self._thread.end()
