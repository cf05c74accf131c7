"""The time of the record, by which its events grow old. Pure: the caller gives the times.

A wall clock may be years wrong until NTP or a person sets it. So rows are not stamped with it, but with a time of the
record's own. While a service runs, it passes as fast as the clock that never jumps. For the time in which none ran it
goes by the wall clock, once that has not been set for an hour, and no further than a tenth of `keep_days`.
"""

from dataclasses import dataclass
from typing import NamedTuple

from beamtouch_common.spans import span

TRUSTED_AFTER_S = 3600.0
"""A wall clock that has not been set for this long tells how long no service ran. NTP sets it minutes after a start."""
_SET_S, _SLEW = 60.0, 1e-3
"""A wall clock that is this far from where it would be, and more than this part of the time, has been set. NTP corrects
less without a jump."""
_LONGEST_OFF = 0.1
"""The part of `keep_days` for which a wall clock is believed that no service ran: a weekend of 30 days. A machine that
was off for longer keeps its events that much longer; one whose clock is wrong loses no more than this."""


class RecordTime(NamedTuple):
    """The time of a record, as it is stored."""

    passed_s: float
    """How long the record has been there, as far as that is known."""
    clock_s: float | None = None
    """The wall clock up to which that counts [s since 1970]; None if it was never trusted."""


@dataclass(frozen=True)
class Watch:
    """One service's view of the wall clock that the record goes by."""

    keep_s: float
    """Age at which events are deleted."""
    looked_s: float | None = None
    """When it looked last [s, monotonic]; None before the first time."""
    apart_s: float = 0.0
    """Wall clock less monotonic clock then."""
    steady_since_s: float = 0.0
    """Since when the wall clock has not been set, as far as it has seen [s, monotonic]."""
    is_trusted: bool = False

    def look(self, stored: RecordTime, clock_s: float, uptime_s: float) -> tuple[RecordTime, "Watch", str]:
        """Look at the clocks once more.

        Parameters
        ----------
        stored : the time of the record at the last look of any service
        clock_s : the wall clock that all services of the record share [s since 1970]
        uptime_s : the monotonic clock of this service [s]

        Returns
        -------
        The time of the record now, the watch for the next look, and a warning, which is empty if all is well. Nothing
        has happened until the time is stored.
        """
        apart_s = clock_s - uptime_s
        if self.looked_s is None:
            return stored, Watch(self.keep_s, uptime_s, apart_s, uptime_s), self._doubt(stored, clock_s)
        ran_s, jump_s = uptime_s - self.looked_s, apart_s - self.apart_s
        was_set = abs(jump_s) > _SET_S + _SLEW * ran_s
        since_s = uptime_s if was_set else self.steady_since_s
        is_trusted = self.is_trusted or uptime_s - since_s >= TRUSTED_AFTER_S
        off_s = self._longest_off_s if is_trusted and not self.is_trusted else 0.0
        watch = Watch(self.keep_s, uptime_s, apart_s, since_s, is_trusted)
        way = "forward" if jump_s > 0 else "back"
        warning = f"the clock was set {way} by {span(abs(jump_s))}; events age as before" if was_set else ""
        return _pass(stored, clock_s, ran_s, off_s, is_trusted=is_trusted), watch, warning

    @property
    def _longest_off_s(self) -> float:
        return self.keep_s * _LONGEST_OFF

    def _doubt(self, stored: RecordTime, clock_s: float) -> str:
        """Return a warning if the wall clock is far from the last entry of the record."""
        after_s = 0.0 if stored.clock_s is None else clock_s - stored.clock_s
        if after_s > self._longest_off_s:
            words = f"events age by no more than {span(self._longest_off_s)} of these; set it if it is wrong"
            return f"the clock is {span(after_s)} after the last entry of the record; {words}"
        if after_s < -_SET_S:
            words = "events do not age by it; set it if it is wrong"
            return f"the clock is {span(-after_s)} before the last entry of the record; {words}"
        return ""


def _pass(stored: RecordTime, clock_s: float, ran_s: float, off_s: float, *, is_trusted: bool) -> RecordTime:
    """Let time pass: as much as one service ran since its last look, and at most so much in which none did."""
    new_clock_s = clock_s if is_trusted else stored.clock_s
    if stored.clock_s is None or clock_s < stored.clock_s:
        return RecordTime(stored.passed_s + ran_s, new_clock_s)
    # Several services look in turn: together they count no more than has passed by the clock that they share.
    passed_s = min(clock_s - stored.clock_s, ran_s + off_s)
    # Until the clock is trusted, the time in which no service ran waits to be counted.
    return RecordTime(stored.passed_s + passed_s, clock_s if is_trusted else stored.clock_s + passed_s)
