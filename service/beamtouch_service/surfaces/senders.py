"""Chooses the sender whose samples move the answer of a surface. Pure: the caller gives the time."""

from collections import OrderedDict
from dataclasses import dataclass

from beamtouch_service.surfaces.sequence_log import MAX_SENDERS

RETURNS = 4
"""Times that a sender must come back after another one before there are two. A batch that was held up on its way when
the sender was started anew comes back once."""
QUIET_S = 10.0
"""Without such a return for this long, or for several times the limit of age, there is one sender again."""


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


class Rivals:
    """Notices that two daemons send samples of one surface at the same time.

    A daemon that is started anew has a new boot id, and all samples of the old one are older than its first. So two
    send if, in turn, each sends a sample that is newer than the first one of the other.
    """

    def __init__(self, stale_ms: float, max_senders: int = MAX_SENDERS) -> None:
        self._quiet_s = max(QUIET_S, 4 * stale_ms / 1e3)
        self._max_senders = max_senders
        self._begun_s: OrderedDict[str, float] = OrderedDict()
        """Time of the first sample of each sender [s, monotonic], oldest first."""
        self._last = ("", "")
        """Boot id and address of the newest batch."""
        self._returns = 0
        self._returned_s = 0.0
        self._pair = ("", "")

    def hear(self, boot_id: str, address: str, acquired_s: float) -> None:
        """Take a batch of this sender and address whose last sample was taken at `acquired_s` [s, monotonic]."""
        if any(begun_s > acquired_s for begun_s in self._begun_s.values()):
            return
        before, self._last = self._last, (boot_id, address)
        if boot_id == before[0]:
            return
        if boot_id not in self._begun_s:
            self._begun_s[boot_id] = acquired_s
            if len(self._begun_s) > self._max_senders:
                self._begun_s.popitem(last=False)
            return
        self._returns = self._returns + 1 if acquired_s - self._returned_s < self._quiet_s else 1
        self._returned_s, self._pair = acquired_s, (before[1], address)

    def at(self, now_s: float) -> tuple[str, str] | None:
        """Return the addresses of two daemons that both send at `now_s` [s, monotonic]; None if one sends."""
        is_now = self._returns >= RETURNS and now_s - self._returned_s < self._quiet_s
        return self._pair if is_now else None
