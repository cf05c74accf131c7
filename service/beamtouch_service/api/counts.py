"""What the service counts beyond its surfaces: answers, problems, refusals. Pure."""

import logging
from collections import Counter
from collections.abc import Callable
from time import monotonic

from beamtouch_service.limits import Seldom
from beamtouch_service.problems import Kind

REFUSALS = frozenset({Kind.UNAUTHORIZED, Kind.FORBIDDEN, Kind.TOO_MANY_REQUESTS})
"""Ended before anything of the request but its headers was looked at."""

_log = logging.getLogger("beamtouch.service")


class Counts:
    """Since the start. Refusals are also logged, once per minute and kind, without what the client sent."""

    def __init__(self, clock: Callable[[], float] = monotonic) -> None:
        self.contacts: Counter[tuple[str, str]] = Counter()
        """Contacts served, by surface and state."""
        self.problems: Counter[Kind] = Counter()
        self.rejected: Counter[tuple[str, Kind]] = Counter()
        """Batches that ended in a problem, by surface, without a name where there is no such surface; they changed
        nothing."""
        self.evicted = 0
        """Connections that were closed to make room for others."""
        self._seldom = Seldom()
        self._clock = clock

    def sender_changed(self, surface: str, boot_id: str) -> None:
        """Log that the samples of a surface come from another sender, once per minute and surface."""
        times = self._seldom.due(f"sender of {surface}", self._clock())
        if times:
            words = "surface %s: samples come from another sender, now %s (%d times since the last such line)"
            _log.info(words, surface, boot_id, times)

    def eviction(self, client: str) -> None:
        """Count a connection of this address that was closed to make room; log it once per minute."""
        self.evicted += 1
        times = self._seldom.due("eviction", self._clock())
        if times:
            words = "too many connections: %d closed to make room since the last such line, the newest of %s"
            _log.warning(words, times, client)

    def problem(self, kind: Kind, client: str) -> None:
        """Count an answer that says no, to a client of this address."""
        self.problems[kind] += 1
        if kind not in REFUSALS:
            return
        times = self._seldom.due(kind.slug, self._clock())
        if times:
            _log.warning("refused (%s): %d since the last such line, the newest from %s", kind.slug, times, client)
