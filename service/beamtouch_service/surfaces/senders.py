"""Whose samples make the present of a surface: one sender at a time, known by its boot id. Pure; instants come in."""

from collections import OrderedDict
from dataclasses import dataclass

from beamtouch_service.surfaces.sequence_log import MAX_SENDERS


@dataclass(frozen=True, slots=True)
class _Present:
    """The newest sample: whose, which, when."""

    boot_id: str
    sequence: int
    acquired_s: float


class Senders:
    """Decides which samples move the present.

    Of one sender the sequence number alone decides: it is exact, while the instant of a sample holds whatever its batch
    waited for on the way. Between senders there is nothing but the instants. A sender that another has followed is of
    the past, unless the other turns out to have been a stray: it may return once the present has become stale.
    """

    def __init__(self, stale_ms: float, most: int = MAX_SENDERS) -> None:
        self.changes = 0
        """How often one sender has followed another."""
        self._stale_ms = stale_ms
        self._most = most
        self._present: _Present | None = None
        self._former: OrderedDict[str, int] = OrderedDict()
        """Sequence number of the last present sample of each sender that another has followed."""

    def is_after_present(self, boot_id: str, sequence: int, acquired_s: float, arrival_s: float) -> bool:
        """Say whether a sample moves the present.

        Parameters
        ----------
        boot_id, sequence : name the sample
        acquired_s, arrival_s : when it was taken, and came [s, monotonic]
        """
        present = self._present
        if present is None:
            return True
        if boot_id == present.boot_id:
            return sequence > present.sequence
        if acquired_s < present.acquired_s:
            return False
        if boot_id not in self._former:
            return True
        return (arrival_s - present.acquired_s) * 1e3 > self._stale_ms and sequence > self._former[boot_id]

    def move(self, boot_id: str, sequence: int, acquired_s: float) -> None:
        """Make a sample the present one."""
        if self._present and self._present.boot_id != boot_id:
            self.changes += 1
            self._former.pop(boot_id, None)
            self._former[self._present.boot_id] = self._present.sequence
            if len(self._former) > self._most:
                self._former.popitem(last=False)
        self._present = _Present(boot_id, sequence, acquired_s)
