"""Delivery of one surface's samples to the service: the present first, what waits on the disk after it.

A batch that the service does not take goes to the spool, and with it all that waits. As soon as the service takes
batches again, each live batch is followed by one from the spool, until that is empty. One from the spool that is not
taken rests for a while, and the present does not: a service may have no time for what is late. What was answered with
nothing is sent again, which changes nothing.
"""

import asyncio
import logging
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from http import HTTPStatus
from time import monotonic
from typing import TypeVar

from beamtouch_daemon.faults import BACKOFF_MIN_S, Backoff, Fault
from beamtouch_daemon.outbox import Outbox
from beamtouch_daemon.pipeline import Taken
from beamtouch_daemon.service_client import ServiceClient, UnreachableError
from beamtouch_daemon.spool import Spool, Spooled, SpoolError
from beamtouch_service.samples import MAX_SAMPLES, Batch

MAX_BATCH = min(1000, MAX_SAMPLES)
MAX_BATCH_VALUES = 16_000
"""Samples in one request, and values in them, at most: under half of the MiB that the service takes."""
RETRY_S = 1.0
"""The longest wait before a service that takes nothing is asked again."""
DISK_REST_S = 1.0
"""A disk that failed is left alone for so long."""

_NEVER_ACCEPTED = {HTTPStatus.BAD_REQUEST, HTTPStatus.REQUEST_ENTITY_TOO_LARGE, HTTPStatus.UNPROCESSABLE_ENTITY}
_log = logging.getLogger(__name__)
_T = TypeVar("_T")


@dataclass(frozen=True)
class Sender:
    """What a batch says of where it comes from."""

    surface: str
    channels: list[str]
    boot_id: str


class Disk:
    """The spool, called from the event loop: one thread makes all calls, as each may wait for the disk."""

    def __init__(self, spool: Spool) -> None:
        self.spool = spool
        self._thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix="spool")

    async def call(self, work: Callable[[], _T]) -> _T:
        """Return what `work` returns; SpoolError."""
        return await asyncio.get_running_loop().run_in_executor(self._thread, work)

    def close(self) -> None:
        """Wait for the calls that were begun."""
        self._thread.shutdown()


class Publisher:
    """Sends one surface's samples. Without a disk, what cannot be delivered waits in the outbox."""

    def __init__(
        self, client: ServiceClient, sender: Sender, outbox: Outbox, batch_s: float, disk: Disk | None = None
    ) -> None:
        self.published = 0
        """Samples that the service has acknowledged."""
        self.turned_s = monotonic()
        """When there was progress last, on the monotonic clock; also that nothing can be delivered is progress."""
        self._client = client
        self._sender = sender
        self._outbox = outbox
        self._batch_s = batch_s
        self._disk = disk
        self._most = min(MAX_BATCH, MAX_BATCH_VALUES // len(sender.channels))
        self._fault = Fault(_log, f"{sender.surface}: publishing")
        self._late_fault = Fault(_log, f"{sender.surface}: publishing what waits on the disk")
        self._late_backoff = Backoff(most_s=RETRY_S)
        self._late_rests_until_s = 0.0
        self._delivered: Spooled | None = None
        """Delivered from the disk, and not removed there yet."""
        self._disk_rests_until_s = 0.0
        self._disk_fault = Fault(_log, f"{sender.surface}: spool")

    @property
    def spooled(self) -> int:
        """Samples that wait on the disk."""
        return self._disk.spool.waiting[self._sender.surface] if self._disk else 0

    async def run(self) -> None:
        """Deliver until the outbox is closed and empty; what cannot be delivered then stays on the disk."""
        backoff = Backoff(most_s=RETRY_S)
        next_s = monotonic()
        while await self._has_work():
            self.turned_s = monotonic()
            if len(self._outbox) < self._most:
                await self._outbox.pause(next_s - monotonic())
            next_s = monotonic() + self._batch_s
            if await self._deliver_live():
                await self._deliver_spooled()
                backoff.reset()
                continue
            await self._spool_all()
            if self._outbox.is_closed:
                await asyncio.sleep(BACKOFF_MIN_S)
            else:
                await self._outbox.pause(backoff.next())

    async def _has_work(self) -> bool:
        if self._outbox.is_closed:
            return len(self._outbox) > 0
        return self.spooled > 0 or await self._outbox.filled()

    async def _deliver_live(self) -> bool:
        """Send what waits in memory; return False if it has to be sent again."""
        samples = self._outbox.take(self._most)
        if not samples:
            return True
        try:
            taken = await self._send(self._batch(samples, monotonic()), self._fault)
        except BaseException:  # cancelled: what may not have arrived stays counted
            self._outbox.put_back(samples)
            raise
        if taken is None:
            self._outbox.drop(len(samples))
        elif taken:
            self.published += len(samples)
        else:
            self._outbox.put_back(samples)
        return taken is not False

    async def _deliver_spooled(self) -> None:
        """Send the oldest batch on the disk, if there is one and it is time."""
        if self._disk is None or not self.spooled or self._outbox.is_closed:
            return
        disk, surface = self._disk, self._sender.surface
        if monotonic() < max(self._disk_rests_until_s, self._late_rests_until_s):
            return
        try:
            if self._delivered is None:
                oldest = await disk.call(lambda: disk.spool.oldest(surface))
                if oldest is None:
                    return
                taken = await self._send(oldest.batch, self._late_fault)
                if taken is False:
                    self._late_rests_until_s = monotonic() + self._late_backoff.next()
                    return
                self._late_backoff.reset()
                self._count(oldest.batch, taken)
                self._delivered = oldest
            done = self._delivered
            await disk.call(lambda: disk.spool.remove(surface, done))
            self._delivered = None
        except SpoolError as error:  # the present does not wait for it
            self._disk_fault.failed(str(error))
            self._disk_rests_until_s = monotonic() + DISK_REST_S

    def _count(self, batch: Batch, taken: bool | None) -> None:
        if taken is None:
            self._outbox.drop(len(batch.samples))
        else:
            self.published += len(batch.samples)

    async def _spool_all(self) -> None:
        """Put all that waits in memory on the disk; if that fails it goes on waiting."""
        disk, surface = self._disk, self._sender.surface
        while disk is not None and (samples := self._outbox.take(self._most)):
            batch, newest_s = self._batch(samples, monotonic()), samples[-1].monotonic_s
            try:
                await disk.call(lambda: disk.spool.put(surface, batch, newest_s))  # noqa: B023 - awaited at once
            except SpoolError as error:
                self._outbox.put_back(samples)
                self._disk_fault.failed(str(error))
                return
            except BaseException:
                self._outbox.put_back(samples)
                raise
            self._disk_fault.recovered()

    async def _send(self, batch: Batch, fault: Fault) -> bool | None:
        """Send a batch; return whether the service took it, None if it never will."""
        # A service of before knows no notes, and needs to know none as long as there are none.
        content = batch.model_dump_json(exclude_defaults=True).encode()
        try:
            answer = await self._client.post_samples(self._sender.surface, content)
        except UnreachableError as error:
            fault.failed(f"no answer from {self._client.url} ({error}); trying again")
            return False
        if answer.is_success:
            fault.recovered()
            return True
        if answer.status in _NEVER_ACCEPTED:
            fault.failed(f"the service will never take a batch ({answer.explanation}); it is dropped")
            return None
        fault.failed(f"the service takes no samples ({answer.explanation}); trying again")
        return False

    def _batch(self, samples: Sequence[Taken], now_s: float) -> Batch:
        return Batch(
            boot_id=self._sender.boot_id,
            channels=self._sender.channels,
            newest_age_ms=max(0.0, (now_s - samples[-1].monotonic_s) * 1e3),
            samples=[taken.sample for taken in samples],
            notes=sorted({note for taken in samples for note in taken.notes}),
        )
