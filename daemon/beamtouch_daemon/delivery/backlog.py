"""Brings the record what it lacks of one surface: from the sample that it expects on, in order, a request at a time.

Each boot is delivered by itself, in turn: one that the service refuses, or that the record cannot take, holds up no
other. On a thin line, a live batch goes before each request, and the surfaces take turns.
"""

import asyncio
import logging
import math
from contextlib import nullcontext
from time import monotonic

from beamtouch_daemon.delivery.boots import BacklogState, Boot, SurfaceLogs
from beamtouch_daemon.delivery.client import NEVER_ACCEPTED, ServiceAnswer, ServiceClient, Verdict
from beamtouch_daemon.delivery.log_file import LogFileError
from beamtouch_daemon.delivery.log_store import LogStore
from beamtouch_daemon.delivery.sending import note_refusal, send
from beamtouch_service.samples import Batch, Sample

ASK_S = 1.0
"""While samples are not durable, the record is asked at least this often."""
LAST_ASK_S = 0.2
"""Time between two questions while the daemon stops."""
_logger = logging.getLogger(__name__)


class Backlog:
    """Delivers all boots of one surface."""

    def __init__(self, client: ServiceClient, store: LogStore, logs: SurfaceLogs, line: asyncio.Lock) -> None:
        """Share a line with the backlogs that have the same lock: where it is thin, they take turns."""
        self._client = client
        self._store = store
        self._logs = logs
        self._line = line
        self._over_s = -math.inf
        """End of the last request, on the monotonic clock."""
        self._read: Batch | None = None
        """The chunk that was read last: many small requests are made of one."""

    async def run(self) -> None:
        """Deliver until cancelled."""
        while True:
            boot = min(self._logs.waiting, key=_due_s, default=None)
            wait_s = ASK_S if boot is None else min(ASK_S, _due_s(boot) - monotonic())
            if boot is not None and wait_s <= 0:
                async with self._line if boot.pace.is_thin else nullcontext():
                    await self._let_live_pass(boot)
                    if _due_s(boot) <= monotonic():
                        await self._deliver(boot)
            else:
                await asyncio.sleep(wait_s)

    async def finish(self) -> None:
        """Deliver what is left of each boot until it is durable, or the service does not take it."""
        tried = list[Boot]()
        # A file that is opened late shows more boots.
        while left := [boot for boot in self._logs.by_boot.values() if boot not in tried]:
            boot = left[-1]
            tried.append(boot)
            boot.end()
            while not boot.log.is_empty and await self._deliver(boot):
                pause_s = boot.due_s - monotonic() if boot.missing else LAST_ASK_S
                await asyncio.sleep(pause_s)

    async def _deliver(self, boot: Boot) -> bool:
        """Send what the record lacks of a boot, or ask how far it is; return whether the service took it."""
        first = boot.missing[:1]
        boot.backlog_state = BacklogState.SENDS if first else BacklogState.RESTS
        try:
            batch = await self._batch(boot)
            answer = await send(self._client, self._logs, boot, batch)
        except LogFileError:  # the store says so
            answer = None
        finally:
            boot.backlog_state = BacklogState.RESTS
            boot.changed.set()
            self._over_s = monotonic()
        is_taken = answer is not None and answer.verdict is Verdict.TAKEN
        is_further = is_taken and (not first or boot.missing[:1] != first)
        if is_further or (answer is not None and self._reduce(boot, batch, answer)):
            boot.backoff.reset()
            boot.due_s = monotonic()  # after those that have waited for longer
        else:
            boot.due_s = monotonic() + boot.backoff.next()
        return is_taken

    async def _let_live_pass(self, boot: Boot) -> None:
        """On a thin line, let a live batch go before the next request, if one is to come soon."""
        present, end_s = self._logs.present, monotonic() + boot.pace.rest_of_backlog_s
        if present is None or not boot.pace.is_thin:
            return
        present.backlog_state = BacklogState.WAITS
        present.changed.set()
        try:
            while present.live.sent_s < self._over_s and present.live.next < present.log.next:
                if (wait_s := end_s - monotonic()) <= 0:
                    break
                await present.wait_for_change(wait_s)
        finally:
            present.backlog_state = BacklogState.RESTS

    async def _batch(self, boot: Boot) -> Batch:
        """Return the next samples that the record lacks, as far as they have the same notes."""
        numbers, samples, notes = boot.missing[: boot.pace.most], list[Sample](), list[str]()
        while numbers:
            part = await self._part(boot, numbers)
            if not part.samples or (samples and part.notes != notes):
                break
            notes = list(part.notes)
            samples += part.samples
            numbers = numbers[len(part.samples) :]
        return boot.log.backlog_batch(samples, notes)

    async def _part(self, boot: Boot, numbers: range) -> Batch:
        """Return the first of these samples that lie together, in a chunk or in memory; none if they are gone."""
        chunk = boot.log.chunk_of(numbers[0])
        if chunk is None:
            return boot.log.batch(boot.log.from_memory(numbers))
        batch = self._read
        if batch is None or batch.boot_id != boot.log.head.boot_id or not _holds(batch, numbers[0]):
            batch = self._read = await self._store.read(chunk)
        if batch is None:
            return boot.log.backlog_batch([], [])
        return batch.model_copy(update={"samples": [sample for sample in batch.samples if sample.sequence in numbers]})

    def _reduce(self, boot: Boot, batch: Batch, answer: ServiceAnswer) -> bool:
        """Send half as many next time; drop a sample that is refused alone. False if that does not help."""
        if answer.verdict is not Verdict.SMALLER:
            return False
        if len(batch.samples) > 1:
            boot.pace.halve(len(batch.samples))
        elif batch.samples and answer.problem in NEVER_ACCEPTED:
            (refused,) = batch.samples
            number = refused.sequence
            _logger.warning("%s: sample %d is dropped: %s", self._logs.name, number, answer.explanation)
            boot.refuse(number)
        else:
            note_refusal(self._logs, boot, batch, answer.explanation)
            return False
        return True


def _holds(batch: Batch, number: int) -> bool:
    return batch.samples[0].sequence <= number <= batch.samples[-1].sequence


def _due_s(boot: Boot) -> float:
    """Return when to deliver a boot next, on the monotonic clock."""
    if not boot.missing:
        return max(boot.due_s, boot.last_receipt_s + ASK_S)
    # The next live batch begins with a small gap, if one comes soon.
    return max(boot.due_s, boot.live.begun_s + ASK_S) if boot.is_gap_small else boot.due_s
