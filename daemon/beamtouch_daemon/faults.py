"""Repeated failures: the waits between attempts, and a limit on log messages."""

import logging
from time import monotonic

BACKOFF_MIN_S = 0.1
BACKOFF_MAX_S = 2.0
REPEAT_S = 60.0
"""Shortest time between two log messages of the same kind."""


class Backoff:
    """Waiting times that double from `first_s` up to `max_s`."""

    def __init__(self, first_s: float = BACKOFF_MIN_S, max_s: float = BACKOFF_MAX_S) -> None:
        self._first_s = first_s
        self._max_s = max_s
        self._next_s = first_s

    def reset(self) -> None:
        """Start again from the shortest time, after a success."""
        self._next_s = self._first_s

    def next(self) -> float:
        """Return the next waiting time [s]."""
        now_s = self._next_s
        self._next_s = min(2 * now_s, self._max_s)
        return now_s


class Fault:
    """Logs the failures of one thing, each reason at most once per `REPEAT_S`, and its recovery."""

    def __init__(self, log: logging.Logger, who: str) -> None:
        self._log = log
        self._who = who
        self._logged_s: dict[str, float] = {}
        self._since_s: float | None = None
        self._announced = False

    def failed(self, reason: str) -> None:
        """Note a failure; log it unless the same reason was logged within the last `REPEAT_S`."""
        now_s = monotonic()
        if self._since_s is None:
            self._since_s = now_s
        if now_s - self._logged_s.get(reason, -REPEAT_S) >= REPEAT_S:
            self._log.warning("%s: %s", self._who, reason)
            self._announced = True
            self._logged_s = {old: at_s for old, at_s in self._logged_s.items() if now_s - at_s < REPEAT_S}
            self._logged_s[reason] = now_s

    def recovered(self) -> None:
        """Note a success; log it if the failure was logged."""
        if self._since_s is None:
            return
        if self._announced:
            self._log.info("%s: works again after %.1f s", self._who, monotonic() - self._since_s)
        self._since_s, self._announced = None, False


class Tally:
    """Logs the number of frequent events, at most once per `REPEAT_S`."""

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
