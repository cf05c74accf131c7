"""Records the contacts of all surfaces: every sample once and in order, whatever happens to this service.

What is taken into the record is in memory until a commit (see `surface_record.LATE_S`) writes the events, the memory
of the decision and the cursor of each boot in one transaction. The sender keeps each sample until then.
"""

import asyncio
import logging
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from functools import partial
from typing import TypeVar

from beamtouch_common.log_lines import Repeated
from beamtouch_common.threads import in_thread
from beamtouch_common.uptime import uptime_s
from beamtouch_models.runtime import ModelFile
from beamtouch_service.record.database.errors import RecordAwayError, UnreadableRowError
from beamtouch_service.record.events.changes import Change
from beamtouch_service.record.events.event import OpenEvent
from beamtouch_service.record.events.health import HealthHistory, StoredHealth
from beamtouch_service.record.events.surface_record import SurfaceRecord
from beamtouch_service.record.reading.readers import Readers
from beamtouch_service.record.trail.pending import PendingTrail
from beamtouch_service.record.trail.table import log_added
from beamtouch_service.record.writing.retention import Deleted, Retention
from beamtouch_service.record.writing.transactions import Due, Transactions
from beamtouch_service.record.writing.writer import Writer
from beamtouch_service.samples import Batch
from beamtouch_service.sections import EventsSection
from beamtouch_service.steps import Stepper
from beamtouch_service.surfaces.estimate import Estimate, Estimator
from beamtouch_service.surfaces.surface import Surface

COMMIT_S = 1.0
"""Time between two commits, each of the surfaces of which something is due."""
LOAD_S = 0.4
"""A batch waits this long for what is on record of its boot; without it, its samples come again."""
REST_S = 1.0
"""Pause after the record of a surface could not be read."""
AWAY_S = 15.0
"""Time after which the record counts as away if it has not answered."""
STARTS_OVER_S = 86_400.0
"""Time between two log lines that a health starts over: until it is written, each new boot reads the damaged one."""
STOP_S = 2.0
"""Time for the last commit."""
TIDY_S = 60.0
_DEFAULTS = EventsSection()

_log = logging.getLogger(__name__)
_T = TypeVar("_T")


class Recorder:
    """The record of a service."""

    def __init__(self, events: EventsSection = _DEFAULTS, *, replica: bool = False) -> None:
        """Open a file, the database of a URL, or memory; raises RecordUnusableError if it cannot be used."""
        self.is_replica = replica
        """True if other services have the samples of some surfaces."""
        self.transactions, self.retention = Transactions(events), Retention(events)
        self.races = 0
        """Times that another service had written what this one was about to write."""
        self._ended = asyncio.Event()
        """Set by the next commit that ends events, which then puts a new one here."""
        self._stepper = Stepper()
        self._records: dict[str, SurfaceRecord] = {}
        self._loads: dict[tuple[str, str], asyncio.Task[None]] = {}
        self._unread: dict[str, Surface] = {}
        """Surfaces of which the health on record has yet to be read."""
        self._starts_over = Repeated(_log, every_s=STARTS_OVER_S)
        self._commit: asyncio.Task[None] | None = None
        self._begun_s = 0.0
        """When the commit that runs began [s, monotonic]."""
        self._writer = Writer(self.transactions)
        self.readers = Readers(self.transactions.database)
        self._resume_s: dict[str, float] = {}
        """Surface -> time from which on its record is read again after a failure [s, monotonic]."""
        self.trail = PendingTrail()
        """Changes that the next commit puts on the trail."""
        self._tidied_s = float("-inf")
        self._upkeep: asyncio.Task[None] | None = None

    def watch(self, surface: Surface) -> None:
        """State the health of a surface from the start, as far as it is on record."""
        self._unread[surface.name] = surface

    @property
    def away_because(self) -> str:
        """Return why the record is away; empty while it is there."""
        late_s = time.monotonic() - self._begun_s
        if self._commit and not self._commit.done() and late_s > AWAY_S:
            return f"the database has not answered for {late_s:.0f} s"
        return self._writer.reason

    @property
    def outages(self) -> int:
        """Times that the record went away."""
        return self._writer.outages

    @property
    def waiting(self) -> dict[str, int]:
        """Samples of each surface that are taken and not durable yet."""
        return {name: record.waiting for name, record in self._records.items()}

    @property
    def lost(self) -> dict[str, int]:
        """Samples of each surface that are missing on record: their sender no longer had them."""
        return {name: record.lost for name, record in self._records.items()}

    async def take(
        self, surface: Surface, batch: Batch, weighed: Mapping[int, Estimate]
    ) -> tuple[int | None, int | None]:
        """Take the samples of a batch that are expected; return `durable` and `expected` for its receipt.

        `weighed` are those that the answer stands on, by number; the others are weighed here.
        """
        model = surface.model
        if model is None:
            return _without_model(surface, batch)
        record = self._records.get(surface.name)
        if record is None or record.boot(batch.boot_id) is None:
            await self._load(surface, batch)
            record = self._records.get(surface.name)
        if record is None or record.boot(batch.boot_id) is None or surface.model is not model:
            return None, None
        record.adopt(model)
        record.hear(batch)
        await self._stepper.finish(self._add(record, batch, weighed))
        boot = record.boot(batch.boot_id)
        if boot is None or self._records.get(surface.name) is not record:  # another service has it
            return None, None
        return boot.durable, boot.expected

    def _add(self, record: SurfaceRecord, batch: Batch, weighed: Mapping[int, Estimate]) -> Iterator[None]:
        """Add one sample after another, as long as the record expects them. Between two it may have changed."""
        surface, model, boot = record.surface, record.model, record.boot(batch.boot_id)
        samples = [sample for sample in batch.samples if boot and sample.sequence >= boot.expected]
        estimator = Estimator(model, surface.name)
        known = [weighed[sample.sequence] for sample in samples if sample.sequence in weighed]
        for estimate in known if len(known) == len(samples) else estimator.estimate(batch, samples):
            boot = record.boot(batch.boot_id)
            if surface.model is not model or self._records.get(surface.name) is not record:
                return
            if boot is None or not boot.has_room:
                return
            record.add(batch, estimate)
            yield

    async def _load(self, surface: Surface, batch: Batch) -> None:
        """Read what is on record of the boot of a batch, unless that takes long."""
        if time.monotonic() < self._resume_s.get(surface.name, 0.0):
            return
        key = surface.name, batch.boot_id
        if key not in self._loads:
            load = self._loads[key] = asyncio.create_task(self._read(surface, batch))
            load.add_done_callback(lambda _: self._loads.pop(key))
            load.add_done_callback(partial(self._note_end, f"load {surface.name}"))
            await asyncio.wait([load], timeout=LOAD_S)

    async def _read(self, surface: Surface, batch: Batch) -> None:
        """Read what is on record of the boot of a batch; after a failure, whatever its cause, not again at once."""
        try:
            await self._read_boot(surface, batch)
        except Exception as error:
            self._resume_s[surface.name] = time.monotonic() + REST_S
            if isinstance(error, UnreadableRowError):
                self._writer.note_damage(surface.name, str(error))
            elif isinstance(error, RecordAwayError):
                self._writer.note(str(error))
            else:
                raise

    async def _read_boot(self, surface: Surface, batch: Batch) -> None:
        model = surface.model
        cursors, health_on_record = await self._writer.run(
            lambda transactions: transactions.load(surface.name, batch.boot_id)
        )
        self._writer.note_damage(surface.name)
        if surface.name not in self._records and model:
            health = await self._go_on_with_health(surface.name, model, health_on_record)
            self._records.setdefault(surface.name, SurfaceRecord(surface, model, health))
        if record := self._records.get(surface.name):
            record.put(batch, cursors)

    async def run(self) -> None:
        """Make durable what was taken, and keep the record within its limits, until cancelled."""
        while True:
            self.commit()
            self._begin_upkeep()
            await asyncio.sleep(COMMIT_S)

    def _begin_upkeep(self) -> None:
        if time.monotonic() - self._tidied_s >= TIDY_S and (self._upkeep is None or self._upkeep.done()):
            self._tidied_s = time.monotonic()
            self._upkeep = asyncio.create_task(self._tidy())
            self._upkeep.add_done_callback(partial(self._note_end, "upkeep"))

    def commit(self, *, everything: bool = False) -> "asyncio.Task[None]":
        """Make durable what is due, or everything that was taken so far, unless a commit runs."""
        if self._commit is None or self._commit.done():
            self._begun_s = time.monotonic()
            self._commit = asyncio.create_task(self._write_changes(everything=everything))
            self._commit.add_done_callback(partial(self._note_end, "commit"))
        return self._commit

    async def write(self, call: Callable[[Transactions], _T]) -> _T:
        """Return what a call of the record gives, after what was begun before; raises RecordAwayError.

        It gives no answer for longer than `AWAY_S`.
        """
        try:
            async with asyncio.timeout(AWAY_S):
                return await self._writer.run(call)
        except TimeoutError:
            raise RecordAwayError(f"it has not answered for {AWAY_S:g} s") from None

    async def wait_for_finished(self, find: Callable[[Transactions], tuple[list[Due], int]]) -> list[Due]:
        """Return the events that `find` gives, as `Transactions.due` does, once there are any; raises RecordAwayError.

        While none are due, it is asked again after each commit that ends events. If all that it read were damaged, it
        is asked again at once; other work of the record has a turn before.
        """
        while True:
            ended = self._ended  # taken before the call: some may end meanwhile
            due, count = await self.write(find)
            if due:
                return due
            if not count:
                await ended.wait()

    async def _write_changes(self, *, everything: bool) -> None:
        now_s = time.monotonic()
        records = {name: one for name, one in self._records.items() if everything or one.is_due(now_s)}
        changes = [change for record in records.values() if (change := record.change(now_s))]
        is_tried = bool(changes) or self._writer.is_away
        if is_tried:
            try:
                numbers, lost = await self._writer.run(lambda transactions: _write(transactions, changes))
            except BaseException as error:
                for change in changes:
                    records[change.surface].take_back(change)
                if not isinstance(error, RecordAwayError):
                    raise
                self._writer.note(str(error))
                return
            for name in lost:
                # Another service has written: what is known here is not so any more.
                self.races += 1
                self._records.pop(name, None)
            written = [change for change in changes if change.surface not in lost]
            for change in written:
                records[change.surface].note_durable(change, numbers)
            if any(change.has_ended for change in written):
                self._ended.set()
                self._ended = asyncio.Event()
        if await self._write_trail() and is_tried:
            self._writer.note("")
        if self._unread:
            await self._read_health()

    async def _write_trail(self) -> bool:
        """Put the changes that wait on the trail; return whether none waits any more."""
        if not (due := self.trail.take_due(time.monotonic())):
            return True
        try:
            added = await self._writer.run(lambda transactions: transactions.add_to_trail(due))
        except BaseException as error:
            self.trail.put_back(due)
            if not isinstance(error, RecordAwayError):
                raise
            self._writer.note(str(error))
            return False
        if added and added[0].number == 1:  # this record is a new one, perhaps in the place of another
            self.trail.forget_states(but=due)
        log_added(added)
        return True

    async def _read_health(self) -> None:
        """State the health that is on record of surfaces whose samples have not come yet."""
        try:
            healths = await self._writer.run(lambda transactions: transactions.healths())
        except RecordAwayError as error:
            self._writer.note(str(error))
            return
        for surface in list(self._unread.values()):
            if model := surface.model:
                stored = healths.get(surface.name, StoredHealth())
                history = await self._go_on_with_health(surface.name, model, stored)
                if surface.health is None:
                    surface.health = history.state
            self._unread.pop(surface.name, None)

    async def _go_on_with_health(self, surface: str, model: ModelFile, stored: StoredHealth) -> HealthHistory:
        """Return the health of a surface from what is on record of it, or a new one if that cannot be read."""
        history = await in_thread(lambda: HealthHistory(surface, model, stored))
        if why := history.starts_over_because:
            self._starts_over.failed(f"surface {surface}: its health starts over: {why}")
        return history

    async def _tidy(self) -> None:
        try:
            await self.tidy(time.time(), uptime_s())
        except RecordAwayError as error:
            self._writer.note(str(error))

    async def tidy(self, clock_s: float, uptime_s: float) -> Deleted:
        """Keep the record within its limits, at the times of `Retention.tidy`; return how many events that costs."""
        held = [(name, boot_id) for name, record in self._records.items() for boot_id in record.boot_ids]
        return await self._writer.run(
            lambda transactions: self.retention.tidy(transactions.database, clock_s, uptime_s, held)
        )

    def _note_end(self, work: str, task: "asyncio.Task[None]") -> None:
        """Note whether a task ended in an error that no database is known to raise."""
        if task.cancelled():
            return
        if error := task.exception():
            self._writer.note_unexpected(work, error)
        else:
            self._writer.note_success(work)

    async def flush(self) -> None:
        """Make durable all that was taken so far, unless the record is away."""
        while self._commit and not self._commit.done():
            await asyncio.wait([self._commit])
        await asyncio.wait([self.commit(everything=True)])

    async def close(self) -> None:
        """Make durable what was taken, if that takes no longer than `STOP_S`, and close the database."""
        reason = f"it has not answered for {STOP_S:g} s"
        with suppress(TimeoutError):
            async with asyncio.timeout(STOP_S):
                await self.flush()
                reason = self._writer.reason
        if reason:
            _log.warning("the record of events is away at the stop: %s; daemons keep their samples", reason)
        self.readers.end()
        self._writer.end()


def _write(transactions: Transactions, changes: list[Change]) -> tuple[dict[OpenEvent, int], set[str]]:
    """Make changes durable. This runs in a thread: to find changes of sensors takes a while."""
    for change in changes:
        if change.best:
            change.health.add(change.best)
    return transactions.commit(changes)


def _without_model(surface: Surface, batch: Batch) -> tuple[int | None, int | None]:
    """Return what a surface without a model keeps: nothing, or if its model file cannot be used, all is yet to come."""
    if surface.model_error is not None:
        return None, None
    newest = batch.samples[-1].sequence if batch.samples else (batch.oldest or 1) - 1
    return newest, newest + 1
