"""The way from memory to the disk, beside delivery: samples that the service does not take go to the spool."""

import asyncio
import logging
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from time import monotonic
from typing import TypeVar

from beamtouch_daemon.delivery.outbox import Outbox
from beamtouch_daemon.delivery.spool import Spool, TooLargeError
from beamtouch_daemon.delivery.spool_connection import SpoolError
from beamtouch_daemon.faults import Fault
from beamtouch_daemon.processing.pipeline import Taken
from beamtouch_service.samples import Batch

MAX_REFUSED = 100
"""Refused batches that wait for the disk; more are dropped and counted."""

_log = logging.getLogger(__name__)
_T = TypeVar("_T")


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


class Spooler:
    """Moves one surface's samples from its outbox to the disk; without a disk they stay where they are.

    Parameters
    ----------
    disk
        The spool, if there is one.
    surface
        Its name.
    outbox
        The samples that wait in memory.
    batch_of
        Makes a batch of samples, with the age that it has at an instant.
    most
        Samples in a batch at most.
    """

    def __init__(
        self,
        disk: Disk | None,
        surface: str,
        outbox: Outbox,
        batch_of: Callable[[Sequence[Taken], float], Batch],
        most: int,
    ) -> None:
        self._disk = disk
        self._surface = surface
        self._outbox = outbox
        self._batch_of = batch_of
        self._most = most
        self._refused: deque[tuple[Batch, str]] = deque()
        self._has_work = asyncio.Event()
        self._is_wanted = False
        self._writes = asyncio.Lock()
        self._fault = Fault(_log, f"{surface}: spool")

    @property
    def is_busy(self) -> bool:
        """Whether samples are on their way to the disk, or wait for it."""
        return self._writes.locked() or bool(self._refused)

    def want(self) -> None:
        """Ask for all that waits in memory to be put on the disk soon."""
        self._is_wanted = True
        self._has_work.set()

    def refuse(self, batch: Batch, reason: str) -> None:
        """Keep a batch that the service will never take for a person to look at; without a disk it is dropped."""
        if self._disk is None or len(self._refused) >= MAX_REFUSED:
            self._outbox.drop(len(batch.samples))
            self._fault.failed(f"a batch that the service will never take is dropped ({reason})")
            return
        self._refused.append((batch, reason))
        self._has_work.set()

    async def run(self) -> None:
        """Write for ever what is asked for."""
        while True:
            await self._has_work.wait()
            self._has_work.clear()
            await self.write_refused()
            if self._is_wanted:
                self._is_wanted = False
                await self.write_all()

    async def write_refused(self) -> None:
        """Put on the disk what the service refused for good; where that fails it is dropped and counted."""
        async with self._writes:
            while self._disk is not None and self._refused:
                spool, (batch, reason) = self._disk.spool, self._refused.popleft()
                try:
                    await self._disk.call(lambda: spool.put_refused(self._surface, batch, reason))  # noqa: B023
                except SpoolError as error:
                    self._outbox.drop(len(batch.samples))
                    self._fault.failed(str(error))
                except BaseException:
                    self._outbox.drop(len(batch.samples))
                    raise

    async def write_all(self, *, is_last: bool = False) -> bool:
        """Put all that waits in memory now on the disk; return False if that failed, and some goes on waiting."""
        async with self._writes:
            most, left = self._most, len(self._outbox)
            while self._disk is not None and (samples := self._outbox.take(min(most, left))):
                left -= len(samples)
                batch, newest_s = self._batch_of(samples, monotonic()), samples[-1].monotonic_s
                spool = self._disk.spool
                try:
                    await self._disk.call(lambda: spool.put(self._surface, batch, newest_s, is_last=is_last))  # noqa: B023
                except TooLargeError:
                    if most == 1:
                        self._outbox.drop(1)
                        continue
                    self._outbox.put_back(samples)
                    left += len(samples)
                    most = max(1, len(samples) // 2)
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
        """Count as dropped what was refused and not written."""
        self._outbox.drop(sum(len(batch.samples) for batch, _ in self._refused))
        self._refused.clear()
