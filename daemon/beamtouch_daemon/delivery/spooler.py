"""Writes samples that the service does not take from memory to the spool, alongside delivery."""

import asyncio
import logging
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import TypeVar

from beamtouch_daemon.delivery.outbox import Outbox
from beamtouch_daemon.delivery.spool import Spool, TooLargeError
from beamtouch_daemon.delivery.spool_connection import SpoolError
from beamtouch_daemon.faults import Fault
from beamtouch_daemon.processing.pipeline import Taken
from beamtouch_service.samples import Batch

MAX_REFUSED = 100
"""Limit of refused batches that wait for the disk; further ones are dropped and counted."""

_log = logging.getLogger(__name__)
_T = TypeVar("_T")


class Disk:
    """The spool for use in the event loop: one thread makes all calls, because each may wait for the disk."""

    def __init__(self, spool: Spool) -> None:
        self.spool = spool
        self._thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix="spool")

    async def call(self, work: Callable[[], _T]) -> _T:
        """Run `work` in the thread and return its result; SpoolError if the spool fails."""
        return await asyncio.get_running_loop().run_in_executor(self._thread, work)

    def close(self) -> None:
        """Wait for the calls in progress."""
        self._thread.shutdown()


class Spooler:
    """Moves one surface's samples from its outbox to the spool; without a spool they stay in the outbox.

    Parameters
    ----------
    disk
        The spool, if there is one.
    surface
        Name of the surface.
    outbox
        The samples that wait in memory.
    batch_of
        Returns a batch of samples, with its present age.
    max_samples
        Limit of samples in a batch.
    """

    def __init__(
        self,
        disk: Disk | None,
        surface: str,
        outbox: Outbox,
        batch_of: Callable[[Sequence[Taken]], Batch],
        max_samples: int,
    ) -> None:
        self._disk = disk
        self._surface = surface
        self._outbox = outbox
        self._batch_of = batch_of
        self._max_samples = max_samples
        self._refused: deque[tuple[Batch, str]] = deque()
        self._has_work = asyncio.Event()
        self._is_wanted = False
        self._writes = asyncio.Lock()
        self._fault = Fault(_log, f"{surface}: spool")

    @property
    def is_busy(self) -> bool:
        """Whether samples are being written, or refused batches wait for it."""
        return self._writes.locked() or bool(self._refused)

    def want(self) -> None:
        """Request that all samples in memory are spooled soon."""
        self._is_wanted = True
        self._has_work.set()

    def refuse(self, batch: Batch, reason: str) -> None:
        """Keep a batch for inspection that the service will never take; without a spool, drop it."""
        if self._disk is None or len(self._refused) >= MAX_REFUSED:
            self._outbox.drop(len(batch.samples))
            self._fault.failed(f"dropped a batch that the service will never take ({reason})")
            return
        self._refused.append((batch, reason))
        self._has_work.set()

    async def run(self) -> None:
        """Write what is requested, until cancelled."""
        while True:
            await self._has_work.wait()
            self._has_work.clear()
            await self.write_refused()
            if self._is_wanted:
                self._is_wanted = False
                await self.write_all()

    async def write_refused(self) -> None:
        """Spool refused batches; those that cannot be written are dropped and counted."""
        async with self._writes:
            while self._disk is not None and self._refused:
                spool, (batch, reason) = self._disk.spool, self._refused.popleft()
                is_written = False
                try:
                    await self._disk.call(partial(spool.put_refused, self._surface, batch, reason))
                    is_written = True
                except SpoolError as error:
                    self._fault.failed(str(error))
                finally:  # also when cancelled
                    if not is_written:
                        self._outbox.drop(len(batch.samples))

    async def write_all(self, *, is_last: bool = False) -> bool:
        """Spool all samples that are in memory now; return False if some could not be written and still wait."""
        async with self._writes:
            limit, left = self._max_samples, len(self._outbox)
            while self._disk is not None and (samples := self._outbox.take(min(limit, left))):
                left -= len(samples)
                batch, newest_s = self._batch_of(samples), samples[-1].monotonic_s
                spool = self._disk.spool
                try:
                    await self._disk.call(partial(spool.put, self._surface, batch, newest_s, is_last=is_last))
                except TooLargeError:
                    if limit == 1:
                        self._outbox.drop(1)
                        continue
                    self._outbox.put_back(samples)
                    left += len(samples)
                    limit = max(1, len(samples) // 2)
                    continue
                except SpoolError as error:
                    self._outbox.put_back(samples)
                    self._fault.failed(str(error))
                    return False
                except BaseException:
                    self._outbox.put_back(samples)
                    raise
                self._fault.recovered()
        return True

    def give_up(self) -> None:
        """Count refused batches that were not written as dropped."""
        self._outbox.drop(sum(len(batch.samples) for batch, _ in self._refused))
        self._refused.clear()
