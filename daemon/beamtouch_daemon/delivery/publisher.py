"""Delivery of one surface's samples to the service: new samples first, spooled ones alongside.

Three tasks work independently. This one sends new samples. The spooler writes samples to disk that the service does not
take. Late delivery sends the spooled samples. A batch without an answer is sent again; if the service has it already,
that changes nothing.
"""

import asyncio
import logging
import math
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
from beamtouch_daemon.uptime import uptime_s
from beamtouch_service.samples import MAX_SAMPLES, Batch, Note

MAX_BATCH = min(1000, MAX_SAMPLES)
MAX_BATCH_VALUES = 40_000
"""Limits of samples and of values, covariances included, in one request: under half of the MiB that is accepted."""
LAST_SEND_S = 1.0
"""While the daemon stops, samples are spooled if the service does not answer within this time."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Sender:
    """Origin of a batch."""

    surface: str
    channels: list[str]
    boot_id: str
    noise_mm: list[float] | None = None
    """Standard deviation of one reading of each channel, if it is known."""
    characteristic: str | None = None
    """Identity of the characteristics and rest gaps."""
    beam: str | None = None
    """Identity of the beam and layout, if the configuration states it."""


class Publisher:
    """Sends one surface's samples. Without a spool, undelivered samples wait in the outbox."""

    def __init__(
        self, client: ServiceClient, sender: Sender, outbox: Outbox, batch_s: float, disk: Disk | None = None
    ) -> None:
        self.turned_s = monotonic()
        """Time of the last progress on the monotonic clock; a failed attempt to deliver is progress too."""
        self._client = client
        self._sender = sender
        self._outbox = outbox
        self._batch_s = batch_s
        self._disk = disk
        channels = len(sender.channels)
        self._max_samples = min(MAX_BATCH, MAX_BATCH_VALUES // (channels + channels * (channels + 1) // 2))
        self._published = 0
        self._is_refused = False
        """Whether the service takes no samples of this surface at all."""
        self._fault = Fault(_log, f"{sender.surface}: publishing")
        self._spooler = Spooler(disk, sender.surface, outbox, self._batch, self._max_samples)
        self._late = disk and LateDelivery(client, sender.surface, disk, batch_s, lambda: self._is_refused)

    @property
    def published(self) -> int:
        """Samples that the service has acknowledged."""
        return self._published + (self._late.delivered if self._late else 0)

    @property
    def spooled(self) -> int:
        """Samples in the spool."""
        return self._disk.spool.waiting[self._sender.surface] if self._disk else 0

    @property
    def helpers(self) -> list[Callable[[], Awaitable[None]]]:
        """Functions to run alongside `run`, each in its own task, until cancelled."""
        return [self._spooler.run, self._late.run] if self._late else []

    async def run(self) -> None:
        """Deliver until the outbox is closed and empty; undelivered samples stay in the spool."""
        backoff = Backoff(max_s=RETRY_S)
        next_s = monotonic()
        while await self._outbox.filled() and not self._outbox.is_closed:
            self.turned_s = monotonic()
            if len(self._outbox) < self._max_samples:
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
        """Count refused batches that are not in the spool as dropped."""
        self._spooler.give_up()

    async def _finish(self) -> None:
        """Deliver or spool the remaining samples, whichever works first; until cancelled."""
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
        """Send samples from memory; return False if some must be sent again."""
        samples = self._outbox.take(self._max_samples)
        if not samples:
            self._is_refused = False  # no new sample can tell
            return True
        parcel = Parcel(samples, self._batch)
        verdict = Verdict.LATER
        try:
            verdict = await parcel.send(self._client, self._sender.surface, self._fault)
        finally:  # also when cancelled, so that every sample stays counted
            self._published += parcel.taken
            self._outbox.put_back(parcel.left)
            for batch, reason in parcel.refused:
                self._spooler.refuse(batch, reason)
        self._is_refused = verdict in {Verdict.LATER, Verdict.ODD}
        return not parcel.left

    def _batch(self, samples: Sequence[Taken]) -> Batch:
        # One look at one clock: an interruption between two would falsify the age.
        now_s = uptime_s()
        # The service validates what it receives.
        return Batch.model_construct(
            boot_id=self._sender.boot_id,
            channels=self._sender.channels,
            newest_age_ms=max(0.0, (now_s - samples[-1].monotonic_s) * 1e3),
            sent_us=math.floor(now_s * 1e6),
            samples=[taken.sample for taken in samples],
            notes=["rate"] if any(Note.RATE in taken.notes for taken in samples) else [],
            noise_mm=self._sender.noise_mm,
            characteristic=self._sender.characteristic,
            beam=self._sender.beam,
        )
