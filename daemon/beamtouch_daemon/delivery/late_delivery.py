"""Delivery of one surface's spooled samples, alongside new ones and never ahead of them.

Batches are sent oldest first. The service may refuse some of them for now: those for a model of another beam or with
other channels, or one that it answers with an error. They are passed over, and the first of each kind is tried again
now and then.
"""

import asyncio
import logging
from collections.abc import Callable, Sequence
from functools import partial
from time import monotonic

from beamtouch_daemon.delivery.client import ServiceClient, Verdict
from beamtouch_daemon.delivery.parcel import Parcel
from beamtouch_daemon.delivery.spool_connection import SpoolError
from beamtouch_daemon.delivery.spool_row import Spooled
from beamtouch_daemon.delivery.spooler import Disk
from beamtouch_daemon.faults import Backoff, Fault
from beamtouch_daemon.uptime import uptime_s
from beamtouch_service.samples import MAX_AGE_MS, Batch, Sample

RETRY_S = 1.0
"""Longest wait after a batch that was not taken."""
DISK_REST_S = 1.0
"""Pause after the disk failed."""
IDLE_S = 0.1
"""Longest time between two checks for spooled batches."""
SWEEP_S = 0.2
"""Delivered batches are deleted together, this often, as each transaction waits for the disk three times."""
OPEN_S = 2.0
"""Time between attempts to open a spool that could not be opened."""
PASSED_REST_S = 5.0
"""Pause before a batch that was passed over is tried again."""
MAX_PASSED = 20
"""Limit of the kinds of batches that are passed over at the same time."""
ODD_ANSWERS = 3
"""A batch is passed over after this many unexpected answers in a row."""

_log = logging.getLogger(__name__)
_Kind = tuple[str | None, ...] | int


class LateDelivery:
    """Sends the spooled batches of one surface.

    Parameters
    ----------
    client
        Client of the service.
    surface
        Name of the surface.
    disk
        The spool.
    pace_s
        Pause after each batch, which leaves time for new samples.
    is_held
        Returns whether the service has refused the surface's new samples, so that trying is useless.
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
        """Number of the last batch that was delivered or passed over."""
        self._passed: dict[_Kind, int] = {}
        """Number of the first batch of each kind that was passed over."""
        self._try_passed_s = 0.0
        self._odd = 0
        self._backoff = Backoff(max_s=RETRY_S)
        self._fault = Fault(_log, f"{surface}: publishing spooled samples")
        self._disk_fault = Fault(_log, f"{surface}: spool")
        self._sweep_s = 0.0
        self._open_s = 0.0

    async def run(self) -> None:
        """Deliver until cancelled."""
        while True:
            rest_s = await self._turn()
            await asyncio.sleep(rest_s)

    async def _turn(self) -> float:
        """Send the next batch, if there is one; return how long to pause [s]."""
        await self._open()
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
        if _needs(oldest.batch) in self._passed:
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
        """Return the kind under which to pass the batch over; None if it must be sent again first."""
        if verdict in {Verdict.TAKEN, Verdict.NEVER}:
            return ()
        if len(self._passed) >= MAX_PASSED:
            return None
        if verdict is Verdict.UNFIT:
            return _needs(oldest.batch)
        return oldest.number if self._odd >= ODD_ANSWERS else None

    async def _try_passed(self) -> float:
        """Try the first batch that was passed over; continue from there once it is taken."""
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
        parcel = Parcel(batch.samples, lambda part: _part(oldest, part))
        verdict = await parcel.send(self._client, surface, self._fault)
        if parcel.left:
            return verdict  # the parts that were taken are sent again, which changes nothing
        self.delivered += parcel.taken
        # Shielded: a stop while the disk is busy must not leave what is counted as delivered in the spool.
        if not parcel.taken:
            (_, reason), *_ = parcel.refused
            await asyncio.shield(self._disk.call(lambda: spool.keep_aside(surface, oldest.number, reason)))
            return Verdict.NEVER
        await asyncio.shield(self._disk.call(lambda: spool.remove(surface, oldest)))
        for part, reason in parcel.refused:
            await self._disk.call(partial(spool.put_refused, surface, part, reason))
        return Verdict.TAKEN

    async def _oldest(self, after: int) -> Spooled | None:
        return await self._disk.call(lambda: self._disk.spool.oldest(self._surface, after))

    async def _open(self) -> None:
        """Open the spool if it is not open; try again every `OPEN_S` while the disk is full."""
        if self._disk.spool.is_open or monotonic() < self._open_s:
            return
        self._open_s = monotonic() + OPEN_S
        try:
            await self._disk.call(self._disk.spool.open)
        except SpoolError as error:
            self._disk_fault.failed(str(error))

    async def _sweep(self) -> None:
        """Delete delivered batches. Delivery continues even if the disk cannot be written."""
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


def _needs(batch: Batch) -> tuple[str | None, ...]:
    """Return what a model must fit for the batch to be taken: its beam and its channels."""
    return (batch.beam, *batch.channels)


def _part(spooled: Spooled, samples: Sequence[Sample]) -> Batch:
    """Return a batch with some of its samples, and their present age."""
    batch = spooled.batch
    earlier_s = max(0, batch.samples[-1].acquired_unix_us - samples[-1].acquired_unix_us) / 1e6
    # Samples of a boot without the time are dated 1970: after the next boot, they count as older than can be stated.
    age_ms = min((uptime_s() - spooled.newest_s + earlier_s) * 1e3, MAX_AGE_MS)
    # The clock that it was sent by may be that of another boot.
    return batch.model_copy(update={"samples": list(samples), "newest_age_ms": age_ms, "sent_us": None})
