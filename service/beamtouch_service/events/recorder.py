"""Puts every contact on record: folds what surfaces tell, and writes it in a thread of its own.

Everything that touches the file, and the estimates of late samples, is done by that one thread, so that the present
never waits for the past. What is present, and what is asked, passes the late samples that wait there.
"""

import logging
import time
from collections import OrderedDict
from collections.abc import Callable
from concurrent.futures import Future
from functools import partial
from itertools import pairwise
from pathlib import Path
from sqlite3 import Error as SqliteError
from threading import BoundedSemaphore
from typing import TypeVar

from beamtouch_models.modelfile import ModelFile
from beamtouch_service.events.file import EventFile
from beamtouch_service.events.pieces import End
from beamtouch_service.events.segmenter import Command, Folder, Loss, fold_late
from beamtouch_service.events.store import EventStore
from beamtouch_service.events.worker import Turns
from beamtouch_service.limits import KEEP_DAYS
from beamtouch_service.limits import MAX_MB as MOST_MB
from beamtouch_service.samples import Batch, Sample
from beamtouch_service.surfaces.contact import State
from beamtouch_service.surfaces.estimates import estimate
from beamtouch_service.surfaces.surface import Surface
from beamtouch_service.surfaces.touch import Follower, Levels, Seen, levels

MOST_LATE = 20_000
"""Late samples that may wait: about a second of work, and some 20 MB."""
STOP_S = 1.0
"""What waits at the stop is done for so long."""
_WAITING_WRITES = 1000
_MAX_EDGES = 4096
_LOOK_S = 60.0
_COMPLAIN_S = 60.0

_log = logging.getLogger("beamtouch.service.events")

_T = TypeVar("_T")

Edges = dict[int, tuple[int, State | None]]
"""Sample number -> time [us] and state, next to a gap."""


class Recorder:
    """Witness of all surfaces of a service."""

    def __init__(self, path: Path | None = None, keep_days: float = KEEP_DAYS, most_mb: float = MOST_MB) -> None:
        """Open the file, or keep the events in memory; raises EventStoreError if the file cannot be used."""
        self.lost = 0
        """Writes that failed, found no room, or waited at the stop: parts of contacts that are not on record."""
        self._file = EventFile(path, keep_days * 86_400, int(most_mb * 1e6), time.time())
        self._turns = Turns("events")
        self._writes = BoundedSemaphore(_WAITING_WRITES)
        # Late samples, each count changed by one thread only: as told, and as written or lost.
        self._late_told = self._late_done = 0
        self._end_s = float("inf")
        self._folders: dict[str, tuple[str, str, Folder]] = {}
        """Surface -> boot id and model that its folder is for."""
        self._edges: OrderedDict[tuple[str, str, int], tuple[int, State | None]] = OrderedDict()
        self._levels: tuple[str, Levels] | None = None
        self._unsettled: set[str] = set()
        """Surfaces of which a write was lost: what is open on record may have ended."""
        self._settling: Future[None] | None = None
        self._looked_s = float("-inf")
        self._complained_s = float("-inf")

    def present(self, surface: Surface, model: ModelFile, boot_id: str, seen: list[Seen]) -> None:
        """Note samples that moved the present, in order."""
        commands: list[Command] = []
        edges: Edges = {}
        former = self._folders.get(surface.name)
        if former is None or former[:2] != (boot_id, model.identity):
            if former:
                self._interrupt(surface.name, former)
            former = boot_id, model.identity, Folder(surface.name, model.identity, boot_id)
            self._folders[surface.name] = former
        folder = former[2]
        for one in seen:
            number = one.estimated.sequence
            if folder.last is None or number != folder.last[0] + 1:
                if folder.last:
                    edges[folder.last[0]] = folder.last[1:]
                edges[number] = (one.estimated.acquired_unix_us, one.state)
            commands += folder.add(one)
        if commands or edges:
            self._submit(surface.name, boot_id, commands, edges)

    def stale(self, surface: Surface) -> None:
        """End what goes on: the newest sample of this surface is too old."""
        former = self._folders.get(surface.name)
        commands = former[2].expire() if former else []
        if former and commands:
            self._submit(surface.name, former[0], commands, {})

    def settle(self) -> None:
        """Try again to end what a lost write left open on record; to be called now and then."""
        if self._unsettled and (self._settling is None or self._settling.done()):
            self._settling = self._turns.prompt(self._settle)

    @property
    def late_waiting(self) -> int:
        """Late samples that are not written yet."""
        return self._late_told - self._late_done

    def has_room(self, samples: int) -> bool:
        """Say whether so many late samples more may wait."""
        return self.late_waiting + samples <= MOST_LATE

    def late(self, surface: Surface, model: ModelFile, batch: Batch, samples: list[Sample]) -> None:
        """Note samples of a batch that came after later ones, in order."""
        # Beside present ones they are taken without room, but not without end.
        if self.late_waiting > 2 * MOST_LATE:
            self._lose("late samples come faster than they can be recorded")
            return
        name, hold_ms, count = surface.name, surface.stale_ms, len(samples)
        self._late_told += count

        def run() -> None:
            self._attempt(lambda: self._write_late(name, hold_ms, model, batch, samples))
            self._late_done += count

        self._turns.late(run)

    def ask(self, question: Callable[[EventStore], _T]) -> "Future[_T]":
        """Have a question answered in the thread, one at a time, after all that was told of the present before."""
        self._flush()
        return self._turns.prompt(lambda: question(self._file.store))

    def close(self) -> None:
        """Write what can be written in a second, and close the file."""
        lost = self.lost
        self._flush()
        self._end_s = time.monotonic() + STOP_S
        self._turns.close()
        if self.lost > lost:
            _log.warning("%d writes were lost at the stop", self.lost - lost)
        try:
            self._note_lost(self._file.close(time.time()))
        except SqliteError as error:
            _log.warning("the file of events could not be closed properly: %s", error)

    def _flush(self) -> None:
        for name, (boot_id, _, folder) in self._folders.items():
            commands = folder.flush()
            if commands:
                self._submit(name, boot_id, commands, {})

    def _interrupt(self, name: str, former: tuple[str, str, Folder]) -> None:
        boot_id, _, folder = former
        edges: Edges = {folder.last[0]: folder.last[1:]} if folder.last else {}
        self._submit(name, boot_id, folder.interrupt(), edges)

    def _submit(self, name: str, boot_id: str, commands: list[Command], edges: Edges) -> None:
        if not self._writes.acquire(blocking=False):
            self._unsettled.add(name)
            self._lose("the disk is too slow")
            return

        def run() -> None:
            if not self._attempt(partial(self._write_present, name, boot_id, commands, edges)):
                self._unsettled.add(name)
            self._writes.release()

        self._turns.prompt(run)

    def _attempt(self, work: Callable[[], None]) -> bool:
        """Do it, and say whether it was done; what fails is counted."""
        if time.monotonic() > self._end_s:
            self._lose("the service stops")
            return False
        try:
            work()
            if time.monotonic() - self._looked_s >= _LOOK_S:
                self._looked_s = time.monotonic()
                self.look_after()
        except SqliteError as error:
            self._lose(str(error))
        except Exception:  # noqa: BLE001  # whatever it is, the next events must not be lost too
            self.lost += 1
            _log.exception("events are lost")
        else:
            return True
        return False

    def _settle(self) -> None:
        for name in list(self._unsettled):
            try:
                self._write_present(name, "", [], {})
            except SqliteError:
                self._unsettled.add(name)

    def _write_present(self, name: str, boot_id: str, commands: list[Command], edges: Edges) -> None:
        # Before it is tried: a write that is lost meanwhile makes it unsettled again.
        if name in self._unsettled:
            self._unsettled.discard(name)
            commands = [Loss(), *commands]
        self._write(name, boot_id, commands, edges)

    def _write(self, name: str, boot_id: str, commands: list[Command], edges: Edges) -> None:
        self._remember(name, boot_id, edges)
        if commands:
            self._file.store.write(name, commands, time.time())

    def _write_late(self, name: str, hold_ms: float, model: ModelFile, batch: Batch, samples: list[Sample]) -> None:
        estimates = estimate(model, name, batch.channels, samples)
        if self._levels is None or self._levels[0] != model.identity:
            self._levels = model.identity, levels(model)
        gaps = [i + 1 for i, (one, other) in enumerate(pairwise(estimates)) if other.sequence != one.sequence + 1]
        for begin, end in pairwise([0, *gaps, len(estimates)]):
            run = estimates[begin:end]
            before = self._state_before(name, batch.boot_id, run[0].sequence)
            follower = Follower(self._levels[1], name, hold_ms, touching=before is State.CONTACT)
            seen = [follower.step(one) for one in run]
            after = self._edges.get((name, batch.boot_id, run[-1].sequence + 1))
            commands = fold_late(Folder(name, model.identity, batch.boot_id, before, End.UNSEEN), seen, after)
            edges = {one.estimated.sequence: (one.estimated.acquired_unix_us, one.state) for one in (seen[0], seen[-1])}
            self._write(name, batch.boot_id, commands, edges)

    def _state_before(self, name: str, boot_id: str, sequence: int) -> State | None:
        edge = self._edges.get((name, boot_id, sequence - 1))
        if edge:
            return edge[1]
        return State.CONTACT if self._file.store.goes_on(name, boot_id, sequence - 1) else None

    def _remember(self, name: str, boot_id: str, edges: Edges) -> None:
        for number, edge in edges.items():
            self._edges[name, boot_id, number] = edge
        while len(self._edges) > _MAX_EDGES:
            self._edges.popitem(last=False)

    def look_after(self) -> None:
        """See that the file is in its place, and drop what is too old or too much; for the recorder's thread."""
        now_s = time.time()
        self._note_lost(self._file.look_after(now_s))
        dropped = self._file.store.prune(now_s)
        if dropped:
            _log.info("%d events dropped: too old, or more than there is room for", dropped)

    def _note_lost(self, events: int) -> None:
        if events:
            self.lost += events
            _log.error("%d events are lost with the file that they were in", events)

    def _lose(self, reason: str) -> None:
        self.lost += 1
        now_s = time.monotonic()
        if now_s - self._complained_s >= _COMPLAIN_S:
            self._complained_s = now_s
            _log.warning("events are lost: %s", reason)
