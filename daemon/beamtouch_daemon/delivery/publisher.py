"""Delivery of one surface's samples to the service: the present first, what waits on the disk beside it.

Three tasks, none of which waits for another: this one sends what is new; the spooler puts on the disk what the service
does not take; late delivery sends what waits there. What was answered with nothing is sent again, which changes
nothing.
"""

import asyncio
import logging
from collections.abc import Awaitable, Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from time import monotonic

from beamtouch_daemon.delivery.client import ServiceClient, Verdict
from beamtouch_daemon.delivery.late_delivery import RETRY_S, LateDelivery
from beamtouch_daemon.delivery.outbox import Outbox
from beamtouch_daemon.delivery.parcel import Parcel
from beamtouch_daemon.delivery.spooler import Disk, Spooler
from beamtouch_daemon.faults import BACKOFF_MIN_S, Backoff, Fault
from beamtouch_daemon.processing.pipeline import Taken
from beamtouch_service.samples import MAX_SAMPLES, Batch

MAX_BATCH = min(1000, MAX_SAMPLES)
MAX_BATCH_VALUES = 16_000
"""Samples in one request, and values in them, at most: under half of the MiB that the service takes."""
LAST_SEND_S = 1.0
"""How long the service may take for an answer while the daemon stops, before the samples go to the disk."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Sender:
    """What a batch says of where it comes from."""

    surface: str
    channels: list[str]
    boot_id: str


class Publisher:
    """Sends one surface's samples. Without a disk, what cannot be delivered waits in the outbox."""

    def __init__(
        self, client: ServiceClient, sender: Sender, outbox: Outbox, batch_s: float, disk: Disk | None = None
    ) -> None:
        self.turned_s = monotonic()
        """When there was progress last, on the monotonic clock; also that nothing can be delivered is progress."""
        self._client = client
        self._sender = sender
        self._outbox = outbox
        self._batch_s = batch_s
        self._disk = disk
        self._most = min(MAX_BATCH, MAX_BATCH_VALUES // len(sender.channels))
        self._published = 0
        self._is_refused = False
        """Whether the service takes no samples of this surface, whatever they are."""
        self._fault = Fault(_log, f"{sender.surface}: publishing")
        self._spooler = Spooler(disk, sender.surface, outbox, self._batch, self._most)
        self._late = disk and LateDelivery(client, sender.surface, disk, batch_s, lambda: self._is_refused)

    @property
    def published(self) -> int:
        """Samples that the service has acknowledged."""
        return self._published + (self._late.delivered if self._late else 0)

    @property
    def spooled(self) -> int:
        """Samples that wait on the disk."""
        return self._disk.spool.waiting[self._sender.surface] if self._disk else 0

    @property
    def helpers(self) -> list[Callable[[], Awaitable[None]]]:
        """What is to run beside `run`, each in a task of its own, for ever."""
        return [self._spooler.run, self._late.run] if self._late else []

    async def run(self) -> None:
        """Deliver until the outbox is closed and empty; what cannot be delivered then stays on the disk."""
        backoff = Backoff(most_s=RETRY_S)
        next_s = monotonic()
        while await self._outbox.filled() and not self._outbox.is_closed:
            self.turned_s = monotonic()
            if len(self._outbox) < self._most:
                await self._outbox.pause(next_s - monotonic())
            next_s = monotonic() + self._batch_s
            if await self._deliver():
                backoff.reset()
                continue
            self._spooler.want()
            await self._outbox.pause(backoff.next())
            if not len(self._outbox):
                self._is_refused = False
        await self._finish()

    def give_up(self) -> None:
        """Count as dropped what was refused for good and is not on the disk."""
        self._spooler.give_up()

    async def _finish(self) -> None:
        """Deliver what is left, or put it on the disk, whichever is possible first; until cancelled."""
        while len(self._outbox) or self._spooler.is_busy:
            self.turned_s = monotonic()
            is_delivered = False
            with suppress(TimeoutError):
                async with asyncio.timeout(LAST_SEND_S):
                    is_delivered = await self._deliver()
            await self._spooler.write_refused()
            if not is_delivered and not await self._spooler.write_all(is_last=True):
                await asyncio.sleep(BACKOFF_MIN_S)

    async def _deliver(self) -> bool:
        """Send what waits in memory; return False if it has to be sent again."""
        samples = self._outbox.take(self._most)
        if not samples:
            self._is_refused = False  # there is nothing new to ask the service with
            return True
        parcel = Parcel(samples, lambda part: self._batch(part, monotonic()))
        verdict = Verdict.LATER
        try:
            verdict = await parcel.send(self._client, self._sender.surface, self._fault)
        finally:  # also when cancelled: what may not have arrived stays counted
            self._published += parcel.taken
            self._outbox.put_back(parcel.left)
            for batch, reason in parcel.refused:
                self._spooler.refuse(batch, reason)
        self._is_refused = verdict in {Verdict.LATER, Verdict.ODD}
        return not parcel.left

    def _batch(self, samples: Sequence[Taken], now_s: float) -> Batch:
        return Batch(
            boot_id=self._sender.boot_id,
            channels=self._sender.channels,
            newest_age_ms=max(0.0, (now_s - samples[-1].monotonic_s) * 1e3),
            samples=[taken.sample for taken in samples],
            notes=sorted({note for taken in samples for note in taken.notes}),
        )
