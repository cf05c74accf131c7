"""The waits between attempts."""

FIRST_S = 0.1
MAX_S = 2.0


class Backoff:
    """Waiting times that double from `first_s` up to `max_s` [s]."""

    def __init__(self, first_s: float = FIRST_S, max_s: float = MAX_S) -> None:
        self._first_s = first_s
        self._max_s = max_s
        self._next_s = first_s

    def reset(self) -> None:
        """Start again from the shortest time, after a success."""
        self._next_s = self._first_s

    def next(self) -> float:
        """Return the next waiting time [s]."""
        wait_s = self._next_s
        self._next_s = min(2 * wait_s, self._max_s)
        return wait_s
