"""Sends one surface's new samples as they come. A batch that fails is not repeated: the next one is newer.

Where the line carries all of them, a batch holds what came since the last one. Where it is thin and the record lacks
earlier samples, a batch holds the newest few, and the backlog brings the others. Once what the record lacks is little,
a batch begins there: the record is up to date with one request, and nothing travels twice.
"""

import asyncio
import math
from collections.abc import Sequence
from time import monotonic

from beamtouch_common.uptime import uptime_s
from beamtouch_common.waits import Backoff
from beamtouch_daemon.delivery.boots import BacklogState, Boot, SurfaceLogs
from beamtouch_daemon.delivery.client import ServiceClient
from beamtouch_daemon.delivery.sending import send
from beamtouch_daemon.processing.pipeline import TimedSample
from beamtouch_service.samples import Batch

LIVE_RETRY_S = 1.0
"""Longest wait after a live batch that was not taken."""
MAX_IN_FLIGHT = 2
"""Live batches without an answer at the same time, on a long way."""


class Live:
    """Sends the new samples of the present boot."""

    def __init__(self, client: ServiceClient, logs: SurfaceLogs, boot: Boot) -> None:
        self._client = client
        self._logs = logs
        self._boot = boot
        self._backoff = Backoff(max_s=LIVE_RETRY_S)
        self._has_failed = False
        """True if the last batch was not taken."""
        self._due_s = -math.inf
        """Time from which on the next one may go out after that, on the monotonic clock."""
        self._took_s = 0.0
        """Time of the last batch that was taken [s]."""

    async def run(self) -> None:
        """Send until cancelled."""
        boot = self._boot
        boot.live.restart()
        async with asyncio.TaskGroup() as requests:
            while True:
                while (wait_s := self._next_s() - monotonic()) > 0:
                    await boot.wait_for_change(wait_s)
                if samples := self._samples():
                    boot.live.begin(samples[0].sample.sequence, samples[-1].sample.sequence)
                    requests.create_task(self._send(samples))
                else:
                    boot.fresh.clear()
                    await boot.fresh.wait()

    def _next_s(self) -> float:
        """Return when a batch may go out, on the monotonic clock; infinite: not before another one is over."""
        boot, pace = self._boot, self._boot.pace
        if boot.live.in_flight >= MAX_IN_FLIGHT:
            return math.inf
        if boot.live.in_flight:
            return max(self._due_s, boot.live.begun_s + pace.overlap_s)
        if not pace.is_thin or not boot.is_behind or boot.backlog_state is BacklogState.WAITS:
            return self._due_s
        rest_s = pace.beside_s if boot.backlog_state is BacklogState.SENDS else pace.rest_s(self._took_s)
        return max(self._due_s, boot.live.begun_s + rest_s)

    def _samples(self) -> list[TimedSample]:
        """Return the samples of the next batch; none if there are no new ones."""
        boot = self._boot
        if boot.live.next >= boot.log.next:
            return []
        limit = boot.pace.live_limit(is_behind=boot.is_behind)
        first = max(boot.live.next, boot.log.next - limit, boot.log.oldest_in_memory)
        if boot.is_gap_small and boot.backlog_state is not BacklogState.SENDS:
            first = boot.missing.start
        return boot.log.from_memory(range(first, boot.log.next))

    async def _send(self, samples: Sequence[TimedSample]) -> None:
        boot, first = self._boot, samples[0].sample.sequence
        boot.live.sent_s = begin_s = monotonic()
        boot.changed.set()
        try:
            answer = await send(self._client, self._logs, boot, self._batch(samples))
        finally:
            boot.live.end(first)
            boot.changed.set()
        if answer is None or answer.receipt is None:
            boot.live_failed = self._has_failed = True
            self._due_s = monotonic() + self._backoff.next()
            return
        if self._has_failed:
            self._has_failed = False
            self._backoff.reset()
            boot.hasten()
        self._took_s = monotonic() - begin_s

    def _batch(self, samples: Sequence[TimedSample]) -> Batch:
        # One look at one clock: an interruption between two would falsify the age.
        now_s = uptime_s()
        age_ms = max(0.0, (now_s - samples[-1].monotonic_s) * 1e3)
        update = {"backlog": False, "newest_age_ms": age_ms, "sent_us": math.floor(now_s * 1e6)}
        return self._boot.log.batch(samples).model_copy(update=update)
