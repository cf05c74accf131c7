"""The two readers of a log. `Live` sends new samples as they come; `Backlog` brings the record what it lacks.

A live batch that fails is not repeated. The backlog asks for the next sample that the record expects, and sends from
there, in order, one request of a surface at a time. Each boot is delivered by itself: one that the service refuses, or
that the record cannot take, holds up no other.
"""

import asyncio
import logging
import math
from collections.abc import Sequence
from time import monotonic

from beamtouch_common.waits import Backoff
from beamtouch_daemon.delivery.client import NEVER_ACCEPTED, Answer, ServiceClient, UnreachableError, Verdict
from beamtouch_daemon.delivery.log import Log
from beamtouch_daemon.delivery.log_file import LogFileError
from beamtouch_daemon.delivery.log_store import LogStore, SurfaceLogs
from beamtouch_daemon.processing.pipeline import Taken
from beamtouch_daemon.uptime import uptime_s
from beamtouch_service.samples import Batch

LIVE_RETRY_S = 1.0
"""Longest wait after a live batch that was not taken; `log` has that of the backlog."""
ASK_S = 1.0
"""While samples are not durable, the record is asked at least this often."""
LAST_ASK_S = 0.2
"""Time between two questions while the daemon stops."""
_log = logging.getLogger(__name__)


class Live:
    """Sends one surface's new samples."""

    def __init__(self, client: ServiceClient, logs: SurfaceLogs, log: Log) -> None:
        self._client = client
        self._logs = logs
        self._log = log

    async def run(self) -> None:
        """Send until cancelled."""
        backoff = Backoff(max_s=LIVE_RETRY_S)
        while True:
            await self._log.fresh.wait()
            self._log.fresh.clear()
            while samples := self._log.for_live():
                try:
                    answer = await send(self._client, self._logs, self._log, self._batch(samples))
                finally:
                    self._log.live_from = samples[-1].sample.sequence + 1
                if answer is not None and answer.receipt is not None:
                    backoff.reset()
                else:
                    await asyncio.sleep(backoff.next())

    def _batch(self, samples: Sequence[Taken]) -> Batch:
        # One look at one clock: an interruption between two would falsify the age.
        now_s = uptime_s()
        age_ms = max(0.0, (now_s - samples[-1].monotonic_s) * 1e3)
        update = {"backlog": False, "newest_age_ms": age_ms, "sent_us": math.floor(now_s * 1e6)}
        return self._log.batch(samples).model_copy(update=update)


class Backlog:
    """Delivers all logs of one surface."""

    def __init__(self, client: ServiceClient, store: LogStore, logs: SurfaceLogs) -> None:
        self._client = client
        self._store = store
        self._logs = logs

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
            answer = await send(self._client, self._logs, log, batch)
        except LogFileError:  # the store says so
            answer = None
        is_taken = answer is not None and answer.verdict is Verdict.TAKEN
        if is_taken:
            log.most = min(2 * log.most, log.max_batch)
        is_further = is_taken and (not first or log.missing[:1] != first)
        if is_further or (answer is not None and self._reduce(log, batch, answer)):
            log.backoff.reset()
            log.due_s = 0.0
        else:
            log.due_s = monotonic() + log.backoff.next()
        return is_taken

    async def _batch(self, log: Log) -> Batch:
        numbers = log.missing[: log.most]
        chunk = log.chunk_of(numbers[0]) if numbers else None
        if chunk is not None and (batch := await self._store.read(chunk)) is not None:
            return batch.model_copy(update={"samples": [one for one in batch.samples if one.sequence in numbers]})
        return log.batch(log.from_memory(numbers) if numbers else [])

    def _reduce(self, log: Log, batch: Batch, answer: Answer) -> bool:
        """Send half as many next time; drop a sample that is refused alone. False if that does not help."""
        if answer.verdict is not Verdict.SMALLER:
            return False
        if len(batch.samples) > 1:
            log.most = len(batch.samples) // 2
        elif batch.samples and answer.problem in NEVER_ACCEPTED:
            number = batch.samples[0].sequence
            _log.warning("%s: sample %d is dropped: %s", self._logs.name, number, answer.explanation)
            log.refuse(number)
        else:
            _note_refusal(self._logs, log, batch, answer.explanation)
            return False
        return True


async def send(client: ServiceClient, logs: SurfaceLogs, log: Log, batch: Batch) -> Answer | None:
    """Send a batch of a log with what the log still holds; return the answer, None if there was none."""
    batch = batch.model_copy(update={"oldest": log.oldest, "earlier": logs.others(log)})
    try:
        answer = await client.post_samples(logs.name, batch)
    except UnreachableError as error:
        advice = f"{error.advice}; " if error.advice else ""
        logs.fault.failed(f"no answer from {client.url} ({error}); {advice}trying again")
        return None
    if answer.receipt is not None:
        if batch.backlog and log.refusal:
            _log.info("%s: the service takes the samples of boot %s again", logs.name, batch.boot_id)
        if not batch.backlog or logs.present is None:
            logs.fault.over()
        log.told(answer.receipt)
    elif answer.verdict is Verdict.REFUSED:
        _note_refusal(logs, log, batch, answer.explanation)
    elif answer.verdict is Verdict.LATER:
        logs.fault.failed(f"the service takes no samples ({answer.explanation}); trying again")
    return answer


def _note_refusal(logs: SurfaceLogs, log: Log, batch: Batch, reason: str) -> None:
    """Note that the service takes no samples of a log for this reason."""
    if not batch.backlog:
        logs.fault.failed(f"the service takes no samples ({reason}); trying again")
    elif reason != log.refusal:
        words = "%s: the samples of boot %s wait, the service does not take them (%s)"
        _log.warning(words, logs.name, batch.boot_id, reason)
    log.refusal = reason


def _due_s(log: Log) -> float:
    """Return when to deliver a boot next, on the monotonic clock."""
    return log.due_s if log.missing else max(log.due_s, log.told_s + ASK_S)
