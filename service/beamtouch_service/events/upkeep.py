"""What the recorder's thread does about once a second, and once a minute."""

import logging
import time
from collections.abc import Mapping
from functools import partial

from sqlalchemy.exc import DBAPIError

from beamtouch_service.events.file import EventsAwayError
from beamtouch_service.events.late import LateSamples
from beamtouch_service.events.losses import Losses
from beamtouch_service.events.store import EventStore
from beamtouch_service.events.writer import Writer
from beamtouch_service.surfaces.surface import Surface

_TIDY_S = 60.0
_QUIET_S = 10.0
"""Time beyond two limits of age after which another service that wrote nothing of an open event is dead."""

_log = logging.getLogger("beamtouch.service.events")


class Upkeep:
    """Completes what was left, and keeps the record within its limits.

    Parameters
    ----------
    store, writer, losses, late
        The parts of the recorder.
    surfaces
        The surfaces, by name.
    """

    def __init__(
        self, store: EventStore, writer: Writer, losses: Losses, late: LateSamples, surfaces: Mapping[str, Surface]
    ) -> None:
        self._store, self._writer, self._losses, self._late = store, writer, losses, late
        self._surfaces = surfaces
        self._tidied_s = float("-inf")
        self._in_place = True

    @property
    def is_due(self) -> bool:
        """Whether there may be something to do."""
        return bool(self._writer.incomplete) or self._store.is_shared or self._is_untidy()

    def run(self) -> None:
        """Do what is due."""
        try:
            self._writer.catch_up()
            if self._store.is_shared and not self._writer.is_away:
                self._decide_again()
            if self._is_untidy():
                self._writer.ask(lambda _store: self.tidy())
        except DBAPIError as error:
            self._losses.warn(f"the file of events cannot be maintained: {error.orig}")
        except EventsAwayError:
            return  # the log has it

    def tidy(self) -> None:
        """Check that the file is in its place, and drop events beyond the limits."""
        self._tidied_s = time.monotonic()
        self.check_place()
        if self._store.is_shared:
            stale_s = max((surface.stale_ms for surface in self._surfaces.values()), default=0.0) / 1e3
            self._store.finish_abandoned(time.time() - 2 * stale_s - _QUIET_S)
        dropped = self._store.prune(time.time())
        if dropped:
            _log.info("%d events were dropped: too old, or above the size limit", dropped)

    def check_place(self) -> None:
        """Log and count, once, that the file is not in its place."""
        if self._in_place and not self._store.is_in_place():
            self._in_place = False
            self._losses.count += 1
            _log.error("the file of events was deleted or replaced while open; restart the service to record events")

    def _decide_again(self) -> None:
        """Decide doubtful samples whose predecessors another service has recorded meanwhile."""
        for surface in self._surfaces.values():
            model = surface.model
            if model is not None:
                self._writer.write_late(surface.name, partial(self._late.again, surface.name, surface.stale_ms, model))

    def _is_untidy(self) -> bool:
        return time.monotonic() - self._tidied_s >= _TIDY_S
