"""Writes to the record of events that were lost: counted, and logged once per minute and reason."""

import logging
import time
from collections.abc import Callable

from sqlalchemy.exc import DBAPIError

from beamtouch_service.limits import Seldom

_log = logging.getLogger("beamtouch.service.events")


class Losses:
    """Counts writes that failed, found no room, or waited at the stop: parts of contacts that are not on record."""

    def __init__(self) -> None:
        self.count = 0
        self.end_s = float("inf")
        """After this time [s, monotonic], nothing is written."""
        self._seldom = Seldom()

    def attempt(self, write: Callable[[], None]) -> bool:
        """Write and return whether it succeeded; count and log a failure."""
        if time.monotonic() > self.end_s:
            self.note("the service is stopping")
            return False
        try:
            write()
        except DBAPIError as error:
            self.note(str(error.orig))
        except Exception:  # noqa: BLE001  # an unexpected error must not lose the next events too
            self.count += 1
            _log.exception("events are lost")
        else:
            return True
        return False

    def note(self, reason: str) -> None:
        """Count a loss and log its reason."""
        self.count += 1
        self.warn(f"events are lost: {reason}")

    def warn(self, message: str) -> None:
        """Log a message, once per minute."""
        if self._seldom.due(message, time.monotonic()):
            _log.warning(message)
