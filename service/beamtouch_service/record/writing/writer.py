"""The one writer of the record: a thread with a connection of its own. It says when the record is away, and back."""

import logging
from collections.abc import Callable
from itertools import chain
from typing import TypeVar

from beamtouch_common.log_lines import Repeated
from beamtouch_common.threads import Workers
from beamtouch_service.record.writing.transactions import Transactions

_log = logging.getLogger(__name__)
_T = TypeVar("_T")


class Writer:
    """Writes one thing after another, in the order in which it is told to."""

    def __init__(self, transactions: Transactions) -> None:
        self.outages = 0
        """Times that the record went away."""
        self._reason, self._said = "", ""
        self._damaged: dict[str, str] = {}
        """Surface -> why what is on record of it cannot be read."""
        self._failed: dict[str, str] = {}
        """Work -> the error that ended it, until it succeeds."""
        self._transactions, self._thread, self._fault = transactions, Workers("record"), Repeated(_log)
        self.note(transactions.away_because)

    @property
    def is_away(self) -> bool:
        """True if the database takes nothing."""
        return bool(self._reason)

    @property
    def reason(self) -> str:
        """Return why the record is away, or a work of it or the record of a surface; empty while all is there."""
        return self._reason or next(chain(self._failed.values(), self._damaged.values()), "")

    async def run(self, call: Callable[[Transactions], _T]) -> _T:
        """Return what a call of the record gives; raises RecordAwayError. It may wait for what was begun before."""
        return await self._thread.run(lambda: call(self._transactions))

    def note(self, reason: str) -> None:
        """Note that the record is away for this reason, or with an empty one that it is there."""
        self._reason = reason
        self._say()

    def note_damage(self, surface: str, reason: str = "") -> None:
        """Note that what is on record of a surface cannot be read for this reason, or with an empty one that it can."""
        self._damaged.pop(surface, None)
        if reason:
            self._damaged[surface] = reason
        self._say()

    def _say(self) -> None:
        """Log that the record went away, or that it is back."""
        before, self._said = self._said, self.reason
        if self.reason and not before:
            self.outages += 1
            words = f"the record of events is away: {self.reason}; answers go on, and daemons keep their samples"
            self._fault.failed(words)
        elif before and not self.reason:
            self._fault.over("the record of events is back")

    def note_unexpected(self, work: str, error: BaseException) -> None:
        """Note that a work of the record ended in an error that no database is known to raise: the record is away."""
        if self._fault.due(f"{error!r}"):
            _log.error("the record cannot be read or written", exc_info=error)
        self._failed[work] = f"unexpected error ({error!r})"
        self.note(self._failed[work])

    def note_success(self, work: str) -> None:
        """Note that a work succeeded. The record is back with its next commit."""
        self._failed.pop(work, None)
        self._say()

    def end(self) -> None:
        """End the thread after what was begun, and close the database."""
        # Nobody waits for it: a disk that does not answer must not hold up a stop.
        self._thread.post(self._transactions.close)
        self._thread.end()
