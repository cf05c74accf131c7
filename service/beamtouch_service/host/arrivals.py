"""When a request that is read now arrived at the earliest.

The kernel keeps what arrives while the process is stopped, or busy for long, and does not say when it came. So the
service notes when its event loop last looked at the connections: nothing was there that it left unread.
"""

import selectors
from collections.abc import Callable

LOOK_S = 0.05
"""The loop looks at the connections at least this often [s]."""
PAUSE_S = 0.1
"""If it has not looked for longer [s], requests may have waited."""
_MAX_LOOKS = 256
"""Looks after a pause within which a busy loop has accepted every connection that waited, and read from it."""


class Arrivals:
    """The earliest arrival of what is read now.

    Parameters
    ----------
    clock
        Returns the time [s].
    since_s
        Time since which connections may wait before the first look; default: now.
    """

    def __init__(self, clock: Callable[[], float], since_s: float | None = None) -> None:
        self._clock = clock
        self._looked_s = clock()
        self._paused_s = self._looked_s if since_s is None else since_s
        """Last look before the pause."""
        self._looks_left = _MAX_LOOKS
        """Looks until all that waited during a pause counts as read; 0: it is read."""

    @property
    def has_caught_up(self) -> bool:
        """Whether all that waited during a pause is read."""
        return self._looks_left == 0

    def now(self) -> float:
        """Return the earliest arrival of what is read now, at most `PAUSE_S` too late [s]."""
        now_s = self._clock()
        if self._looks_left:
            return self._paused_s
        return now_s if now_s - self._looked_s <= PAUSE_S else self._looked_s

    def caught_up(self) -> None:
        """Note that nothing waits to be read, and nothing that was read waits to be handled."""
        self._looks_left = 0

    def looked(self) -> None:
        """Note that the loop has just looked at the connections."""
        now_s = self._clock()
        if now_s - self._looked_s > PAUSE_S:
            if not self._looks_left:
                self._paused_s = self._looked_s
            self._looks_left = _MAX_LOOKS
        elif self._looks_left:
            self._looks_left -= 1
        self._looked_s = now_s


class Selector(selectors.DefaultSelector):
    """The selector of an event loop, which notes each look."""

    def __init__(self, arrivals: Arrivals) -> None:
        super().__init__()
        self._arrivals = arrivals

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        """Wait for connections as every selector does, but return after `LOOK_S` at the latest."""
        wait_s = LOOK_S if timeout is None else min(timeout, LOOK_S)
        found: list[tuple[selectors.SelectorKey, int]] = []
        if wait_s > 0 and not self._arrivals.has_caught_up:
            # The loop has nothing else to do. If there is nothing to read either, the pause is over.
            found = super().select(0)
            if not found:
                self._arrivals.caught_up()
        found = found or super().select(wait_s)
        self._arrivals.looked()
        return found
