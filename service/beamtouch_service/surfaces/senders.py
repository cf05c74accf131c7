"""Chooses the sender whose samples move the answer of a surface. Pure: the caller gives the time."""

from collections import OrderedDict
from dataclasses import dataclass

from beamtouch_service.surfaces.sequence_log import MAX_SENDERS


@dataclass(frozen=True, slots=True)
class _Newest:
    """Sender, number and time of the newest sample."""

    boot_id: str
    sequence: int
    acquired_s: float


class Senders:
    """Decides which samples move the answer.

    A boot id identifies a sender. Samples from one sender are ordered by sequence number alone, which is exact: the
    time of a sample includes the delay of its batch. Samples from different senders are ordered by time. A sender that
    another one has replaced may return only once the newest sample is stale, in case the other one was a stray.
    """

    def __init__(self, stale_ms: float, max_former: int = MAX_SENDERS) -> None:
        self.changes = 0
        """Number of changes of the sender."""
        self._stale_ms = stale_ms
        self._max_former = max_former
        self._newest: _Newest | None = None
        self._former: OrderedDict[str, int] = OrderedDict()
        """Sequence number of the last accepted newest sample of each replaced sender."""

    def is_after_newest(self, boot_id: str, sequence: int, acquired_s: float, arrival_s: float) -> bool:
        """Return whether a sample moves the answer.

        Parameters
        ----------
        boot_id, sequence : name the sample
        acquired_s, arrival_s : times of its acquisition and its arrival [s, monotonic]
        """
        newest = self._newest
        if newest is None:
            return True
        if boot_id == newest.boot_id:
            return sequence > newest.sequence
        if acquired_s < newest.acquired_s:
            return False
        if boot_id not in self._former:
            return True
        return (arrival_s - newest.acquired_s) * 1e3 > self._stale_ms and sequence > self._former[boot_id]

    def move(self, boot_id: str, sequence: int, acquired_s: float) -> None:
        """Make a sample the newest one."""
        if self._newest and self._newest.boot_id != boot_id:
            self.changes += 1
            self._former.pop(boot_id, None)
            self._former[self._newest.boot_id] = self._newest.sequence
            if len(self._former) > self._max_former:
                self._former.popitem(last=False)
        self._newest = _Newest(boot_id, sequence, acquired_s)
