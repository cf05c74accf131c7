"""Records the contacts of all surfaces.

New samples are grouped into segments where they arrive. A single worker thread writes the segments, answers queries and
decides late samples, so that the current contact never waits for the disk. New segments and queries go first.
"""

import logging
import time
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import replace
from functools import partial
from pathlib import Path
from threading import Timer
from typing import TypeVar

from sqlalchemy.exc import DBAPIError

from beamtouch_models.modelfile import ModelFile
from beamtouch_service.events.file import EventsAwayError
from beamtouch_service.events.findings import Finish, Found, Loss
from beamtouch_service.events.health import HealthKeeper
from beamtouch_service.events.health_updates import HealthUpdates
from beamtouch_service.events.late import LateSamples
from beamtouch_service.events.late_queue import LateQueue
from beamtouch_service.events.losses import Losses
from beamtouch_service.events.segmenter import Segmenter
from beamtouch_service.events.segments import End, Segment
from beamtouch_service.events.store import EventStore
from beamtouch_service.events.upkeep import Upkeep
from beamtouch_service.events.worker import Worker
from beamtouch_service.events.write_queue import WriteQueue
from beamtouch_service.events.writer import Writer
from beamtouch_service.limits import KEEP_DAYS, MAX_MB
from beamtouch_service.samples import Batch, Sample
from beamtouch_service.surfaces.follower import Seen
from beamtouch_service.surfaces.surface import Surface

STOP_S = 1.0
"""At the stop, waiting writes get this much time."""

_log = logging.getLogger("beamtouch.service.events")

_T = TypeVar("_T")


class Recorder:
    """Observes the decisions of all surfaces of a service, and records them as events."""

    def __init__(
        self,
        place: Path | str | None = None,
        keep_days: float = KEEP_DAYS,
        max_mb: float = MAX_MB,
        *,
        replica: bool = False,
    ) -> None:
        """Open a file, the database of a URL, or memory; raises EventStoreError if it cannot be used."""
        self.is_replica = replica
        """Whether other services have the samples of some surfaces."""
        self._store = EventStore(place, keep_days * 86_400, int(max_mb * 1e6))
        self._late = LateSamples(self._store)
        self._health = HealthKeeper(self._store)
        self._worker, self._losses = Worker("events"), Losses()
        self._segmenters: dict[str, Segmenter] = {}
        """Surface -> segmenter of its newest samples."""
        self._stale: set[str] = set()
        """Surfaces whose newest sample is too old."""
        self._upkeep: Future[None] | None = None
        self.on_written: Callable[[], None] = lambda: None
        """Called in the worker thread after each write of events."""
        self._health_updates = HealthUpdates(self._worker, self._health, self._losses)
        self.writer = Writer(self._store, self._losses, self._written)
        """Its counts are for the metrics."""
        self._writes = WriteQueue(self._worker, self.writer, self._losses)
        self._late_queue = LateQueue(self._worker, self.writer, self._late, self._losses)
        surfaces = self._health_updates.surfaces
        self._maintenance = Upkeep(self._store, self.writer, self._losses, self._late, surfaces)

    @property
    def lost(self) -> int:
        """Count of writes that were lost."""
        return self._losses.count

    def watch(self, surface: Surface) -> None:
        """State the health of a surface, now and after each of its events."""
        self._health_updates.watch(surface)

    def fresh(self, surface: Surface, model: ModelFile, boot_id: str, seen: list[Seen]) -> None:
        """Record new samples, in order."""
        self._stale.discard(surface.name)
        segmenter = self._segmenters.get(surface.name)
        commands: list[Found] = []
        if segmenter is None or (segmenter.boot_id, segmenter.model) != (boot_id, model.identity):
            commands = segmenter.end_run() if segmenter else []
            segmenter = self._segmenters[surface.name] = Segmenter(surface.name, model, boot_id)
        last = segmenter.last
        if self._store.is_shared and (last is None or seen[0].estimated.sequence != last.sequence + 1):
            # Another service, which may be dead, had the samples before: its open event ends, or goes on with these.
            commands = [Loss(), *commands]
        for one in seen:
            commands += segmenter.add(one)
        name, stale_ms = surface.name, surface.stale_ms
        if commands:
            # The worker thread decides doubtful samples.
            self._writes.add(name, lambda: self._late.commands_in(name, stale_ms, commands))

    def stale(self, surface: Surface) -> None:
        """End the open event of a surface: its newest sample is too old."""
        self._stale.add(surface.name)
        if self._store.is_shared:
            self._leave(surface, End.STALE)
        elif segmenter := self._segmenters.get(surface.name):
            self._writes.add_all(surface.name, segmenter.expire())

    def maintain(self) -> None:
        """End events that a lost write left open, and tidy the file once a minute; call this about once a second."""
        self._store.abandon_stuck()
        if self._maintenance.is_due and (self._upkeep is None or self._upkeep.done()):
            self._upkeep = self._worker.prompt(self._maintenance.run)

    @property
    def late_waiting(self) -> int:
        """Late samples that are not written yet."""
        return self._late_queue.waiting

    def has_room(self, samples: int) -> bool:
        """Return whether this many more late samples may wait."""
        return self._late_queue.has_room(samples)

    def late(self, surface: Surface, model: ModelFile, batch: Batch, samples: list[Sample]) -> None:
        """Record late samples of a batch, in order."""
        self._late_queue.add(surface, model, batch, samples)

    def ask(self, query: Callable[[EventStore], _T]) -> "Future[_T]":
        """Run a query in the worker thread, after everything that was observed of new samples so far.

        The query ends with EventsAwayError while a database is away.
        """
        self._flush()
        return self.look(query)

    def look(self, query: Callable[[EventStore], _T]) -> "Future[_T]":
        """Run a query in the worker thread. What was observed of open events since their last write is not in it."""
        return self._worker.prompt(partial(self.writer.ask, query))

    def answerable(self, event: Segment) -> Segment:
        """Return an event as it is to be answered: not as open if a lost write may have ended it; for a query."""
        if event.end is not End.OPEN or event.surface not in self.writer.incomplete:
            return event
        return replace(event, end=End.STALE if event.surface in self._stale else End.UNSEEN)

    def close(self) -> None:
        """Write what can be written in a second, and close the file."""
        lost = self.lost
        for surface in self._health_updates.surfaces.values() if self._store.is_shared else ():
            self._leave(surface, End.UNFINISHED)
        self._flush()
        self._losses.end_s = time.monotonic() + STOP_S
        frozen = Timer(STOP_S, self._store.abandon)
        frozen.start()
        self._worker.close()
        frozen.cancel()
        self.writer.give_up()
        if self.lost > lost:
            _log.warning("%d writes were lost at the stop", self.lost - lost)
        self._maintenance.check_place()
        try:
            self._health.close()
            self._store.close()
        except DBAPIError as error:
            _log.warning("cannot close the file of events properly: %s", error.orig)
        except EventsAwayError:
            pass  # the log has it

    def tidy(self) -> None:
        """Check that the file is in its place, and drop events beyond the limits; for the worker thread."""
        self._maintenance.tidy()

    def _written(self, name: str) -> None:
        self._health_updates.update(name)
        self.on_written()

    def _flush(self) -> None:
        for name, segmenter in self._segmenters.items():
            self._writes.add_all(name, segmenter.flush())

    def _leave(self, surface: Surface, end: End) -> None:
        """End the run of a surface: another service may have the next sample."""
        segmenter = self._segmenters.pop(surface.name, None)
        if segmenter and segmenter.last:
            finish = Finish(segmenter.boot_id, segmenter.last.sequence, end)
            found, stale_ms = [*segmenter.flush(), finish, *segmenter.end_run()], surface.stale_ms
            self._writes.add(surface.name, lambda: self._late.commands_in(surface.name, stale_ms, found))
