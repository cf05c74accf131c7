"""Updates of the health of surfaces, in the worker thread, soon after each of their events."""

import logging
from concurrent.futures import Future
from functools import partial

from sqlalchemy.exc import DBAPIError

from beamtouch_service.events.file import EventsAwayError
from beamtouch_service.events.health import HealthKeeper
from beamtouch_service.events.losses import Losses
from beamtouch_service.events.worker import Worker
from beamtouch_service.surfaces.surface import Surface

_log = logging.getLogger("beamtouch.service.events")


class HealthUpdates:
    """Keeps the stated health of surfaces up to date."""

    def __init__(self, worker: Worker, keeper: HealthKeeper, losses: Losses) -> None:
        self._worker, self._keeper, self._losses = worker, keeper, losses
        self.surfaces: dict[str, Surface] = {}
        """The surfaces, by name."""
        self._pending: set[str] = set()

    def watch(self, surface: Surface) -> None:
        """State the health of a surface, now and after each of its events."""
        self.surfaces[surface.name] = surface
        self.update(surface.name)

    def update(self, name: str) -> None:
        """Update the health of a surface soon."""
        if name not in self.surfaces or name in self._pending:
            return
        self._pending.add(name)
        self._worker.late(partial(self._run, name)).add_done_callback(partial(log_failure, name))

    def _run(self, name: str) -> None:
        self._pending.discard(name)
        try:
            if self._keeper.update(self.surfaces[name]):
                self.update(name)
        except DBAPIError as error:
            self._losses.warn(f"the health of sensors cannot be updated: {error.orig}")
        except EventsAwayError:
            return  # it is updated with the next event


def log_failure(name: str, done: "Future[None]") -> None:
    """Log an error that a task of the worker thread did not foresee; nobody waits for its result."""
    error = None if done.cancelled() else done.exception()
    if error:
        _log.error("surface %s: its events or the health of its sensors cannot be updated", name, exc_info=error)
