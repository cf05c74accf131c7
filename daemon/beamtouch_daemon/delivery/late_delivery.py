"""Delivery of what waits on the disk for one surface, beside the present and never before it.

Batches go out oldest first. Some cannot go now while others can: the service has a model of other channels, or answers
one batch with an error. Those are passed over, and the first of each kind is tried again now and then.
"""

import asyncio
import logging
from collections.abc import Callable, Sequence
from time import monotonic

from beamtouch_daemon.delivery.client import ServiceClient, Verdict
from beamtouch_daemon.delivery.parcel import Parcel
from beamtouch_daemon.delivery.spool_connection import SpoolError
from beamtouch_daemon.delivery.spool_row import Spooled
from beamtouch_daemon.delivery.spooler import Disk
from beamtouch_daemon.faults import Backoff, Fault
from beamtouch_service.samples import Batch, Sample

RETRY_S = 1.0
"""The longest wait before the next batch is tried, where the last was not taken."""
DISK_REST_S = 1.0
"""A disk that failed is left alone for so long."""
IDLE_S = 0.1
"""How often to look whether there is something to deliver, at least."""
SWEEP_S = 0.2
"""What was delivered is deleted from the disk this often, all at once: each time takes three waits for the disk."""
PASSED_REST_S = 5.0
"""How long a batch rests that was passed over."""
MAX_PASSED = 20
"""Kinds of batches that are passed over at the same time, at most."""
ODD_ANSWERS = 3
"""A batch is passed over after so many answers that nobody foresaw, one after the other."""

_log = logging.getLogger(__name__)
_Kind = tuple[str, ...] | int


class LateDelivery:
    """Sends one surface's batches from the disk.

    Parameters
    ----------
    client
        Of the service.
    surface
        Its name.
    disk
        The spool.
    pace_s
        The rest after each batch, for what is newer.
    is_held
        Whether the service takes nothing of this surface now, as far as is known from its new samples.
    """

    def __init__(
        self, client: ServiceClient, surface: str, disk: Disk, pace_s: float, is_held: Callable[[], bool]
    ) -> None:
        self.delivered = 0
        """Samples that the service has acknowledged."""
        self._client = client
        self._surface = surface
        self._disk = disk
        self._pace_s = pace_s
        self._is_held = is_held
        self._cursor = 0
        """The number of the last batch that was delivered or passed over."""
        self._passed: dict[_Kind, int] = {}
        """The number of the first batch of each kind that was passed over."""
        self._try_passed_s = 0.0
        self._odd = 0
        self._backoff = Backoff(most_s=RETRY_S)
        self._fault = Fault(_log, f"{surface}: publishing what waits on the disk")
        self._disk_fault = Fault(_log, f"{surface}: spool")
        self._sweep_s = 0.0

    async def run(self) -> None:
        """Deliver for ever."""
        while True:
            rest_s = await self._turn()
            await asyncio.sleep(rest_s)

    async def _turn(self) -> float:
        """Send a batch if there is one and it is time; return how long to rest [s]."""
        await self._sweep()
        if self._disk.spool.waiting[self._surface] <= 0 or self._is_held():
            return max(self._pace_s, IDLE_S)
        try:
            if self._passed and monotonic() >= self._try_passed_s:
                return await self._try_passed()
            return await self._send_next()
        except SpoolError as error:
            self._disk_fault.failed(str(error))
            return DISK_REST_S

    async def _send_next(self) -> float:
        oldest = await self._oldest(self._cursor)
        if oldest is None:
            return max(self._pace_s, IDLE_S)
        if tuple(oldest.batch.channels) in self._passed:
            self._cursor = oldest.number
            return 0.0
        verdict = await self._send(oldest)
        if verdict is Verdict.ODD:
            self._odd += 1
        kind = self._kind(oldest, verdict)
        if kind is None:
            return self._backoff.next()
        if verdict not in {Verdict.TAKEN, Verdict.NEVER}:
            self._passed.setdefault(kind, oldest.number)
            self._try_passed_s = monotonic() + PASSED_REST_S
        self._odd = 0
        self._cursor = oldest.number
        self._backoff.reset()
        return self._pace_s

    def _kind(self, oldest: Spooled, verdict: Verdict) -> _Kind | None:
        """Return what such batches are passed over by; None if this one has to be sent again first."""
        if verdict in {Verdict.TAKEN, Verdict.NEVER}:
            return ()
        if len(self._passed) >= MAX_PASSED:
            return None
        if verdict is Verdict.UNFIT:
            return tuple(oldest.batch.channels)
        return oldest.number if self._odd >= ODD_ANSWERS else None

    async def _try_passed(self) -> float:
        """Try again the batch that was passed over first; once it is taken, go on from there."""
        self._try_passed_s = monotonic() + PASSED_REST_S
        kind, number = next(iter(self._passed.items()))
        del self._passed[kind]
        oldest = await self._oldest(number - 1)
        verdict = Verdict.TAKEN
        if oldest is not None and oldest.number == number:
            verdict = await self._send(oldest)
        if verdict not in {Verdict.TAKEN, Verdict.NEVER}:
            self._passed[kind] = number
            return self._pace_s
        self._cursor = min(self._cursor, number)
        return self._pace_s

    async def _send(self, oldest: Spooled) -> Verdict:
        batch, surface, spool = oldest.batch, self._surface, self._disk.spool
        parcel = Parcel(batch.samples, lambda part: _part(batch, part))
        verdict = await parcel.send(self._client, surface, self._fault)
        if parcel.left:
            return verdict  # what was taken of it is sent again, which changes nothing
        self.delivered += parcel.taken
        if not parcel.taken:
            (_, reason), *_ = parcel.refused
            await self._disk.call(lambda: spool.keep_aside(surface, oldest.number, reason))
            return Verdict.NEVER
        await self._disk.call(lambda: spool.remove(surface, oldest))
        for part, reason in parcel.refused:
            await self._disk.call(lambda: spool.put_refused(surface, part, reason))  # noqa: B023 - awaited at once
        return Verdict.TAKEN

    async def _oldest(self, after: int) -> Spooled | None:
        return await self._disk.call(lambda: self._disk.spool.oldest(self._surface, after))

    async def _sweep(self) -> None:
        """Delete what was delivered. Nothing waits for that: on a disk that cannot be written it stays a while."""
        if not self._disk.spool.unremoved or monotonic() < self._sweep_s:
            return
        try:
            await self._disk.call(self._disk.spool.sweep)
        except SpoolError as error:
            self._disk_fault.failed(str(error))
            self._sweep_s = monotonic() + DISK_REST_S
        else:
            self._sweep_s = monotonic() + SWEEP_S
            self._disk_fault.recovered()


def _part(batch: Batch, samples: Sequence[Sample]) -> Batch:
    """Return some samples of a batch as one, with their own age."""
    earlier_us = batch.samples[-1].acquired_unix_us - samples[-1].acquired_unix_us
    age_ms = batch.newest_age_ms + max(0.0, earlier_us / 1e3)
    return batch.model_copy(update={"samples": list(samples), "newest_age_ms": age_ms})
