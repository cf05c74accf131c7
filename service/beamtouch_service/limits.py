"""Bounds on how often: batches per second, lines of log per minute. Pure: instants come in as seconds."""

import logging
from collections.abc import Callable
from time import monotonic

LOG_EVERY_S = 60.0
_MAX_REMEMBERED = 100


class Bucket:
    """So many turns per second on average, and as many at once after a pause of a second."""

    def __init__(self, per_s: float) -> None:
        self._per_s = per_s
        self._most = max(1.0, per_s)
        self._left = self._most
        self._at_s = 0.0

    def take(self, now_s: float) -> float:
        """Take a turn at `now_s` [s]; returns 0, or how long to wait for one [s], and then none was taken."""
        self._left = min(self._most, self._left + max(0.0, now_s - self._at_s) * self._per_s)
        self._at_s = now_s
        if self._left < 1.0:
            return (1.0 - self._left) / self._per_s
        self._left -= 1.0
        return 0.0


class Seldom:
    """Says of things that happen often when to speak of them: the first time, then once per period with the count."""

    def __init__(self, every_s: float = LOG_EVERY_S) -> None:
        self._every_s = every_s
        self._spoken: dict[str, tuple[float, int]] = {}

    def due(self, kind: str, now_s: float) -> int:
        """Note that it happened at `now_s` [s]; returns how often since it was last spoken of, 0 to keep silent."""
        spoken_s, count = self._spoken.get(kind, (float("-inf"), 0))
        if now_s - spoken_s < self._every_s:
            self._spoken[kind] = (spoken_s, count + 1)
            return 0
        if len(self._spoken) >= _MAX_REMEMBERED:
            self._spoken.clear()
        self._spoken[kind] = (now_s, 0)
        return count + 1


class SeldomFilter(logging.Filter):
    """Lets each message of a logger through once per minute: anyone can make a server complain again and again."""

    def __init__(self, clock: Callable[[], float] = monotonic) -> None:
        super().__init__()
        self._seldom = Seldom()
        self._clock = clock

    def filter(self, record: logging.LogRecord) -> bool:
        """Say whether to write it; an exception always is."""
        return record.exc_info is not None or self._seldom.due(str(record.msg), self._clock()) > 0
