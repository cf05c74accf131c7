"""The other reader of a log: it brings the record what it lacks, in order, one request of a surface at a time.

It asks for the next sample that the record expects, and sends from there. Each boot is delivered by itself: one that
the service refuses, or that the record cannot take, holds up no other.
"""

import asyncio
import logging
from contextlib import suppress
from dataclasses import dataclass, field
from time import monotonic

from beamtouch_daemon.delivery.client import Answer, ServiceClient, UnreachableError, Verdict
from beamtouch_daemon.delivery.live import Live
from beamtouch_daemon.delivery.log import MAX_BATCH, Log
from beamtouch_daemon.delivery.log_file import LogFileError
from beamtouch_daemon.delivery.log_store import LogStore
from beamtouch_daemon.faults import Backoff, Fault
from beamtouch_service.samples import Batch

ASK_S = 1.0
"""While samples are not durable, the record is asked at least this often."""
RETRY_S = 5.0
"""Longest wait after a request that brought the record no further."""
LAST_ASK_S = 0.2
"""Time between two questions while the daemon stops."""
_log = logging.getLogger(__name__)


@dataclass
class _Turn:
    """When and how to deliver a boot next."""

    at_s: float = 0.0
    tried_s: float = 0.0
    backoff: Backoff = field(default_factory=lambda: Backoff(max_s=RETRY_S))
    max_samples: int = MAX_BATCH


class Backlog:
    """Delivers all logs of one surface.

    Parameters
    ----------
    client, surface, store
        Where the samples go, and where they come from.
    live
        The live reader of the present boot; None if the surface is no longer configured.
    """

    def __init__(self, client: ServiceClient, surface: str, store: LogStore, live: Live | None = None) -> None:
        self._client = client
        self._surface = surface
        self._store = store
        self._logs = store.surface(surface)
        self._live = live
        self._wake = live.behind if live else asyncio.Event()
        self._turns: dict[str, _Turn] = {}
        self._fault = Fault(_log, f"{surface}: delivering the backlog")

    async def run(self) -> None:
        """Deliver until cancelled."""
        while True:
            now_s = monotonic()
            due = {log: self._due_s(log) for log in self._logs.by_boot.values() if len(log)}
            log = min(due, key=lambda one: due[one], default=None)
            if log is not None and due[log] <= now_s:
                await self._deliver(log)
                continue
            with suppress(TimeoutError):
                async with asyncio.timeout(min([ASK_S, *(at_s - now_s for at_s in due.values())])):
                    await self._wake.wait()
            self._wake.clear()

    async def finish(self) -> None:
        """Deliver what is left of each boot until it is durable, or the service does not take it."""
        self._logs.end()
        for log in reversed(self._logs.by_boot.values()):
            while len(log):
                lacked = log.is_behind
                if not await self._deliver(log):
                    break
                if not lacked:
                    await asyncio.sleep(LAST_ASK_S)

    def _turn(self, log: Log) -> _Turn:
        return self._turns.setdefault(log.sender.boot_id, _Turn())

    def _due_s(self, log: Log) -> float:
        """Return when to deliver a boot on the monotonic clock."""
        turn = self._turn(log)
        is_back = self._live is not None and turn.tried_s < self._live.back_s
        at_s = 0.0 if is_back else turn.at_s
        return at_s if log.is_behind else max(at_s, log.told_s + ASK_S)

    async def _deliver(self, log: Log) -> bool:
        """Send what the record lacks of a boot, or ask how far it is; return whether the service took it."""
        turn, lacked = self._turn(log), log.lacking if log.is_behind else None
        turn.tried_s = monotonic()
        try:
            batch = await self._batch(log, turn.max_samples)
            answer = await self._client.post_samples(self._surface, batch)
        except LogFileError:  # the store says so
            turn.at_s = monotonic() + ASK_S
            return False
        except UnreachableError as error:
            self._failed(log, f"no answer from {self._client.url} ({error}); trying again")
            return False
        if answer.receipt is not None:
            log.told(answer.receipt)
            self._taken(log, is_further=log.lacking != lacked)
            return True
        if answer.verdict is Verdict.SMALLER and self._split(turn, log, batch, answer):
            return True
        if answer.verdict is Verdict.LATER:
            self._failed(log, f"the service takes no samples ({answer.explanation}); trying again")
        else:
            self._refused(log, answer.explanation)
            turn.at_s = monotonic() + turn.backoff.next()
        return False

    async def _batch(self, log: Log, most: int) -> Batch:
        number, most = log.lacking, min(most, log.sender.max_samples)
        if number is None or number >= log.brought:
            batch = log.sender.batch([])
        elif (chunk := log.chunk_of(number)) is not None:
            batch = log.part_of(await self._store.read(chunk), number, most)
        else:
            batch = log.sender.batch(log.memory_from(number, min(most, log.unsent - number)))
        return batch.model_copy(update={"oldest": log.oldest, "earlier": self._logs.others(log)})

    def _taken(self, log: Log, *, is_further: bool) -> None:
        turn = self._turn(log)
        turn.max_samples = min(2 * turn.max_samples, MAX_BATCH)
        self._fault.recovered()
        if log.refusal:
            _log.info("%s: the service takes the samples of boot %s again", self._surface, log.sender.boot_id)
            log.refusal = ""
        if is_further and log.expected is not None:
            turn.backoff.reset()
        else:
            turn.at_s = monotonic() + turn.backoff.next()

    def _split(self, turn: _Turn, log: Log, batch: Batch, answer: Answer) -> bool:
        """Send half as many next time; drop a sample that is refused alone. False if that does not help."""
        if len(batch.samples) > 1:
            turn.max_samples = len(batch.samples) // 2
            return True
        if not batch.samples or not answer.is_of_service:
            return False
        number = batch.samples[0].sequence
        _log.warning("%s: sample %d is dropped: %s", self._surface, number, answer.explanation)
        log.refuse(number)
        return True

    def _refused(self, log: Log, reason: str) -> None:
        if reason != log.refusal:
            words = "%s: the samples of boot %s wait, the service does not take them (%s)"
            _log.warning(words, self._surface, log.sender.boot_id, reason)
        log.refusal = reason

    def _failed(self, log: Log, reason: str) -> None:
        turn = self._turn(log)
        turn.at_s = monotonic() + turn.backoff.next()
        if self._live is None or not self._live.fails:  # else the live reader says why
            self._fault.failed(reason)
