"""The live reader of a log: new samples go to the service as they come. A batch that fails is not repeated."""

import asyncio
import logging
import math
from collections.abc import Sequence
from time import monotonic

from beamtouch_daemon.delivery.client import ServiceClient, UnreachableError, Verdict
from beamtouch_daemon.delivery.log import Log
from beamtouch_daemon.delivery.log_store import SurfaceLogs
from beamtouch_daemon.faults import Backoff, Fault
from beamtouch_daemon.processing.pipeline import Taken
from beamtouch_daemon.uptime import uptime_s
from beamtouch_service.samples import Batch

RETRY_S = 1.0
"""Longest wait after a batch that was not taken."""
_log = logging.getLogger(__name__)


class Live:
    """Sends one surface's new samples."""

    def __init__(self, client: ServiceClient, surface: str, logs: SurfaceLogs, log: Log) -> None:
        self.turned_s = monotonic()
        """Time of the last progress on the monotonic clock; a failed attempt is progress too."""
        self.fails = False
        """Whether the last batch was not taken."""
        self.back_s = 0.0
        """Time on the monotonic clock when a batch was taken after one that was not."""
        self.behind = asyncio.Event()
        """Set when a receipt says that the record lacks samples that were sent."""
        self._client = client
        self._surface = surface
        self._logs = logs
        self._log = log
        self._max_samples = log.sender.max_samples
        self._fault = Fault(_log, f"{surface}: publishing")

    @property
    def waiting(self) -> int:
        """Number of samples that were not sent yet."""
        return self._log.next - self._log.unsent

    async def run(self) -> None:
        """Send until cancelled."""
        backoff = Backoff(max_s=RETRY_S)
        while True:
            await self._log.fresh.wait()
            self._log.fresh.clear()
            while self.waiting:
                self.turned_s = monotonic()
                if await self._send():
                    backoff.reset()
                else:
                    await asyncio.sleep(backoff.next())

    async def _send(self) -> bool:
        """Send the newest samples; return whether they were taken."""
        log = self._log
        samples = log.for_live(self._max_samples)
        if not samples:
            return True
        log.flying = samples[0].sample.sequence
        try:
            return await self._post(samples)
        finally:
            log.flying = None

    async def _post(self, samples: Sequence[Taken]) -> bool:
        try:
            answer = await self._client.post_samples(self._surface, self._batch(samples))
        except UnreachableError as error:
            advice = f"{error.advice}; " if error.advice else ""
            self._failed(f"no answer from {self._client.url} ({error}); {advice}trying again")
            return False
        if answer.receipt is not None:
            self._log.told(answer.receipt)
            self._log.refusal = ""
            self._fault.recovered()
            if self.fails:
                self.fails, self.back_s = False, monotonic()
            self._max_samples = min(2 * self._max_samples, self._log.sender.max_samples)
            if self._log.is_behind:
                self.behind.set()
            return True
        if answer.verdict is Verdict.SMALLER:  # the backlog finds out which of them are taken
            self._max_samples = max(1, len(samples) // 2)
            self.behind.set()
            return True
        if answer.verdict is Verdict.REFUSED:
            self._log.refusal = answer.explanation
        self._failed(f"the service takes no samples ({answer.explanation}); trying again")
        return False

    def _failed(self, reason: str) -> None:
        self.fails = True
        self._fault.failed(reason)

    def _batch(self, samples: Sequence[Taken]) -> Batch:
        # One look at one clock: an interruption between two would falsify the age.
        now_s = uptime_s()
        update = {
            "backlog": False,
            "newest_age_ms": max(0.0, (now_s - samples[-1].monotonic_s) * 1e3),
            "sent_us": math.floor(now_s * 1e6),
            "oldest": self._log.oldest,
            "earlier": self._logs.others(self._log),
        }
        return self._log.sender.batch(samples).model_copy(update=update)
