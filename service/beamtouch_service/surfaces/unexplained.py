"""The unexplained stretches of one surface: their number, their time, and an alarm for a long one. Pure."""

from typing import NamedTuple

from beamtouch_models.runtime import State
from beamtouch_service.surfaces.follower import Decision


class Overdue(NamedTuple):
    """A stretch that lasts too long."""

    since_us: int
    """Time of its first sample, by the sender's clock [us since 1970]."""
    suspect: str | None
    """The channel of `check-NAME`, if there is one."""
    shift_mm: float | None = None
    """By how much all zeros have moved together, if that explains it."""


class Stretches(NamedTuple):
    """The stretches of a surface so far."""

    number: int
    """Stretches since the start."""
    total_s: float
    """Their time, by the ages of the samples [s]."""
    is_overdue: bool
    """True if the current stretch lasts too long."""
    since_us: int | None
    """Time of the first sample of the current stretch, by the sender's clock [us since 1970]; None without one."""


class UnexplainedTracker:
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
        self._length_s = 0.0
        self._suspect: str | None = None
        self.shift_mm: float | None = None
        """By how much all zeros have moved together, if that explains the current stretch."""
        self._overdue: Overdue | None = None

    @property
    def is_overdue(self) -> bool:
        """True if the current stretch lasts too long."""
        return self._length_s > self.after_s

    @property
    def now(self) -> Stretches:
        """The stretches so far."""
        return Stretches(self.count, self.total_s, self.is_overdue, self._since_us)

    def add(self, decision: Decision, passed_s: float) -> None:
        """Add the next sample, with the time since the one before [s]."""
        if decision.held is State.UNEXPLAINED:
            self._extend(decision, passed_s)
        else:
            self._since_us, self._length_s, self.shift_mm = None, 0.0, None

    def _extend(self, decision: Decision, passed_s: float) -> None:
        if self._since_us is None:
            self.count += 1
            self._since_us, self._suspect, passed_s = decision.estimate.sample.acquired_unix_us, None, 0.0
        self._suspect = decision.suspect or self._suspect
        self.shift_mm = decision.shift_mm if decision.shift_mm is not None else self.shift_mm
        was_overdue = self.is_overdue
        self._length_s += passed_s
        self.total_s += passed_s
        if self.is_overdue and not was_overdue:
            self._overdue = Overdue(self._since_us, self._suspect, self.shift_mm)

    def take_overdue(self) -> Overdue | None:
        """Return a stretch that lasts too long, once; None without one."""
        overdue, self._overdue = self._overdue, None
        return overdue
