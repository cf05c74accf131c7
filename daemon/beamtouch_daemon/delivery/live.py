"""The live reader of a log: new samples go to the service as they come. A batch that fails is not repeated."""

import asyncio
import math
from collections.abc import Sequence

from beamtouch_common.waits import Backoff
from beamtouch_daemon.delivery.client import ServiceClient
from beamtouch_daemon.delivery.log import Log
from beamtouch_daemon.delivery.log_store import SurfaceLogs
from beamtouch_daemon.delivery.sending import Sending
from beamtouch_daemon.processing.pipeline import Taken
from beamtouch_daemon.uptime import uptime_s
from beamtouch_service.samples import Batch

RETRY_S = 1.0
"""Longest wait after a batch that was not taken."""


class Live:
    """Sends one surface's new samples."""

    def __init__(self, client: ServiceClient, surface: str, logs: SurfaceLogs, log: Log) -> None:
        self._sending = Sending(client, surface, logs)
        self._log = log

    async def run(self) -> None:
        """Send until cancelled."""
        backoff = Backoff(max_s=RETRY_S)
        while True:
            await self._log.fresh.wait()
            self._log.fresh.clear()
            while samples := self._log.for_live():
                try:
                    answer = await self._sending.send(self._log, self._batch(samples))
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
        return self._log.sender.batch(samples).model_copy(update=update)
