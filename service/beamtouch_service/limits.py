"""Default limits, and rate limits for log lines. Pure: the caller gives the time in seconds."""

import logging
from collections.abc import Callable
from time import monotonic

STALE_MS = 500.0
"""No contact is given from a sample older than this."""
UNEXPLAINED_AFTER_S = 10.0
"""An unexplained stretch that lasts longer needs attention."""
DEGRADED_AFTER_S = 10.0
"""A channel that is not good for longer is out, and needs attention."""
MAX_STREAMS = 32
MAX_CLIENTS_LIMIT = 4096
"""Upper limit of the setting: a new connection may have to search all of them for one to replace."""
MAX_MODBUS_CLIENTS = 32
MODBUS_IDLE_S = 60.0
"""A Modbus connection without a request for this long is closed."""
MQTT_RATE_HZ = 20.0
"""Contacts per second and surface to the MQTT broker."""
KEEP_DAYS = 30.0
MAX_MB = 100.0
"""Size of the record of events."""

LOG_EVERY_S = 60.0
_MAX_REMEMBERED = 100
"""Kinds of messages. Beyond this all are forgotten, so that made-up kinds cannot fill the memory."""


class Seldom:
    """Rate-limits repeated log messages: the first at once, then one per period, with a count."""

    def __init__(self, every_s: float = LOG_EVERY_S) -> None:
        self._every_s = every_s
        self._written: dict[str, tuple[float, int]] = {}

    def due(self, kind: str, now_s: float) -> int:
        """Count a message at `now_s` [s]. Returns how many there were since the last line, or 0 to write none."""
        written_s, count = self._written.get(kind, (float("-inf"), 0))
        if now_s - written_s < self._every_s:
            self._written[kind] = (written_s, count + 1)
            return 0
        if len(self._written) >= _MAX_REMEMBERED:
            self._written.clear()
        self._written[kind] = (now_s, 0)
        return count + 1


class SeldomFilter(logging.Filter):
    """Passes each message of a logger once per minute, because clients can provoke any number of them."""

    def __init__(self, clock: Callable[[], float] = monotonic) -> None:
        super().__init__()
        self._seldom = Seldom()
        self._clock = clock

    def filter(self, record: logging.LogRecord) -> bool:
        """Return whether to write a record. Exceptions are always written."""
        return record.exc_info is not None or self._seldom.due(str(record.msg), self._clock()) > 0
