"""The unexplained stretches of one surface: their number, their time, and an alarm for a long one. Pure."""

from collections.abc import Sequence
from typing import NamedTuple

from beamtouch_models.modelfile import State
from beamtouch_service.surfaces.contact import Decision
from beamtouch_service.surfaces.follower import Seen


class Overdue(NamedTuple):
    """A stretch that lasts too long."""

    since_us: int
    """Time of its first sample, by the sender's clock [us since 1970]."""
    suspect: str | None
    """The channel of `check-NAME`, if there is one."""


class Stretches:
    """Follows the samples that move the answer."""

    def __init__(self, after_s: float) -> None:
        self.after_s = after_s
        """A stretch may last this long [s]."""
        self.count = 0
        """Stretches since the start."""
        self.total_s = 0.0
        """Their time, by the ages of the samples [s]."""
        self._since_us: int | None = None
        """First sample of the current stretch; None without one."""
        self._length_s = self._last_s = 0.0
        self._suspect: str | None = None
        self._overdue: Overdue | None = None

    @property
    def is_overdue(self) -> bool:
        """Whether the current stretch lasts too long."""
        return self._length_s > self.after_s

    def add(self, seen: Sequence[Seen], acquired_s: float) -> None:
        """Add the next samples, of which the last was taken at `acquired_s` [s, monotonic]."""
        newest_us = seen[-1].estimated.acquired_unix_us
        for one in seen:
            # No sample is newer than the last one, whatever happened to the sender's wall clock.
            self._add(one, acquired_s - max(0, newest_us - one.estimated.acquired_unix_us) / 1e6)

    def _add(self, seen: Seen, acquired_s: float) -> None:
        # The ages of two batches differ by how long each travelled. No time counts twice.
        newest_s = max(self._last_s, acquired_s)
        passed_s, self._last_s = newest_s - self._last_s, newest_s
        if seen.held is not State.UNEXPLAINED:
            self._since_us, self._length_s = None, 0.0
            return
        if self._since_us is None:
            self.count += 1
            self._since_us, self._suspect, passed_s = seen.estimated.acquired_unix_us, None, 0.0
        if isinstance(seen.outcome, Decision):
            self._suspect = seen.outcome.suspect or self._suspect
        was_overdue = self.is_overdue
        self._length_s += passed_s
        self.total_s += passed_s
        if self.is_overdue and not was_overdue:
            self._overdue = Overdue(self._since_us, self._suspect)

    def take_overdue(self) -> Overdue | None:
        """Return a stretch that lasts too long, once; None without one."""
        overdue, self._overdue = self._overdue, None
        return overdue
