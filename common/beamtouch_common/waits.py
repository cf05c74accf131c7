"""The waits between attempts."""

FIRST_S = 0.1
MAX_S = 2.0
STEADY_S = 10.0
"""A part that has run for this long, and for as long as the last wait, has recovered."""


class Backoff:
    """Waiting times that double from `first_s` up to `max_s` [s]."""

    def __init__(self, first_s: float = FIRST_S, max_s: float = MAX_S) -> None:
        self._first_s = first_s
        self._max_s = max_s
        self._next_s = first_s
        self._last_s = 0.0

    @property
    def steady_s(self) -> float:
        """A part that has run for this long since the last wait has recovered, and may call `reset` [s]."""
        return max(STEADY_S, self._last_s)

    def reset(self) -> None:
        """Start again from the shortest time, after a success."""
        self._next_s = self._first_s

    def next(self) -> float:
        """Return the next waiting time [s]."""
        self._last_s, self._next_s = self._next_s, min(2 * self._next_s, self._max_s)
        return self._last_s
