"""Things that fail and come back: how long to wait, and what to log so that the log does not fill at the poll rate."""

import logging
from time import monotonic

BACKOFF_MIN_S = 0.1
BACKOFF_MAX_S = 2.0
REPEAT_S = 60.0
"""The same complaint, or the same kind of event, is logged at most this often."""


class Backoff:
    """Waiting times that double from the least to the greatest."""

    def __init__(self, first_s: float = BACKOFF_MIN_S, most_s: float = BACKOFF_MAX_S) -> None:
        self._first_s = first_s
        self._most_s = most_s
        self._next_s = first_s

    def reset(self) -> None:
        """Begin again with the least: it works."""
        self._next_s = self._first_s

    def next(self) -> float:
        """Return how long to wait now [s]."""
        now_s = self._next_s
        self._next_s = min(2 * now_s, self._most_s)
        return now_s


class Fault:
    """One thing that can fail, in the log: each reason once in a while, and that it works again."""

    def __init__(self, log: logging.Logger, who: str) -> None:
        self._log = log
        self._who = who
        self._logged_s: dict[str, float] = {}
        self._since_s: float | None = None
        self._announced = False

    def failed(self, reason: str) -> None:
        """Note a failure; it is logged unless the same reason was within the last `REPEAT_S`."""
        now_s = monotonic()
        if self._since_s is None:
            self._since_s = now_s
        if now_s - self._logged_s.get(reason, -REPEAT_S) >= REPEAT_S:
            self._log.warning("%s: %s", self._who, reason)
            self._announced = True
            self._logged_s = {old: at_s for old, at_s in self._logged_s.items() if now_s - at_s < REPEAT_S}
            self._logged_s[reason] = now_s

    def recovered(self) -> None:
        """Note that it works; logged if the failure was."""
        if self._since_s is None:
            return
        if self._announced:
            self._log.info("%s: works again after %.1f s", self._who, monotonic() - self._since_s)
        self._since_s, self._announced = None, False


class Tally:
    """Events too frequent to be logged one by one: their number, at most once per `REPEAT_S`."""

    def __init__(self, log: logging.Logger, text: str) -> None:
        self._log = log
        self._text = text
        self._logged_s = -REPEAT_S
        self._pending = 0

    def add(self, number: int) -> None:
        """Count `number` more events."""
        self._pending += number
        if self._pending and monotonic() - self._logged_s >= REPEAT_S:
            self._log.warning(self._text, self._pending)
            self._logged_s, self._pending = monotonic(), 0
