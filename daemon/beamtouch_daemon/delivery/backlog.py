"""The other reader of a log: it brings the record what it lacks, in order, one request of a surface at a time.

It asks for the next sample that the record expects, and sends from there. Each boot is delivered by itself: one that
the service refuses, or that the record cannot take, holds up no other.
"""

import asyncio
import logging
from time import monotonic

from beamtouch_daemon.delivery.client import NEVER_ACCEPTED, Answer, ServiceClient, Verdict
from beamtouch_daemon.delivery.log import Log
from beamtouch_daemon.delivery.log_file import LogFileError
from beamtouch_daemon.delivery.log_store import LogStore
from beamtouch_daemon.delivery.sending import Sending
from beamtouch_service.samples import Batch

ASK_S = 1.0
"""While samples are not durable, the record is asked at least this often."""
LAST_ASK_S = 0.2
"""Time between two questions while the daemon stops."""
_log = logging.getLogger(__name__)


class Backlog:
    """Delivers all logs of one surface."""

    def __init__(self, client: ServiceClient, surface: str, store: LogStore) -> None:
        self._surface = surface
        self._store = store
        self._logs = store.surface(surface)
        self._sending = Sending(client, surface, self._logs)

    async def run(self) -> None:
        """Deliver until cancelled."""
        while True:
            logs = [log for log in self._logs.by_boot.values() if not log.is_empty]
            log = min(logs, key=_due_s, default=None)
            wait_s = ASK_S if log is None else min(ASK_S, _due_s(log) - monotonic())
            if log is not None and wait_s <= 0:
                await self._deliver(log)
            else:
                await asyncio.sleep(wait_s)

    async def finish(self) -> None:
        """Deliver what is left of each boot until it is durable, or the service does not take it."""
        for log in reversed(self._logs.by_boot.values()):
            log.end()
            while not log.is_empty and await self._deliver(log):
                pause_s = log.due_s - monotonic() if log.missing else LAST_ASK_S
                await asyncio.sleep(pause_s)

    async def _deliver(self, log: Log) -> bool:
        """Send what the record lacks of a boot, or ask how far it is; return whether the service took it."""
        first = log.missing[:1]
        try:
            batch = await self._batch(log)
            answer = await self._sending.send(log, batch)
        except LogFileError:  # the store says so
            answer = None
        is_taken = answer is not None and answer.verdict is Verdict.TAKEN
        if is_taken:
            log.most = min(2 * log.most, log.sender.max_samples)
        is_further = is_taken and (not first or log.missing[:1] != first)
        if is_further or (answer is not None and self._reduce(log, batch, answer)):
            log.backoff.reset()
            log.due_s = 0.0
        else:
            log.due_s = monotonic() + log.backoff.next()
        return is_taken

    async def _batch(self, log: Log) -> Batch:
        numbers = log.missing[: log.most]
        if numbers and (chunk := log.chunk_of(numbers[0])) is not None:
            batch = await self._store.read(chunk)
            return batch.model_copy(update={"samples": [one for one in batch.samples if one.sequence in numbers]})
        return log.sender.batch(log.from_memory(numbers) if numbers else [])

    def _reduce(self, log: Log, batch: Batch, answer: Answer) -> bool:
        """Send half as many next time; drop a sample that is refused alone. False if that does not help."""
        if answer.verdict is not Verdict.SMALLER:
            return False
        if len(batch.samples) > 1:
            log.most = len(batch.samples) // 2
        elif batch.samples and answer.problem in NEVER_ACCEPTED:
            number = batch.samples[0].sequence
            _log.warning("%s: sample %d is dropped: %s", self._surface, number, answer.explanation)
            log.refuse(number)
        else:
            self._sending.refuse(log, batch, answer.explanation)
            return False
        return True


def _due_s(log: Log) -> float:
    """Return when to deliver a boot next, on the monotonic clock."""
    return log.due_s if log.missing else max(log.due_s, log.told_s + ASK_S)
