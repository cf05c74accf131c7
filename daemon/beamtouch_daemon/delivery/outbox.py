"""The samples of one surface that wait in memory for delivery."""

import asyncio
import contextlib
import logging
from collections import deque
from collections.abc import Callable, Sequence
from typing import NamedTuple

from beamtouch_daemon.faults import Tally
from beamtouch_daemon.processing.pipeline import Taken

_log = logging.getLogger(__name__)


class Promise(NamedTuple):
    """Samples that are made when they are needed."""

    make: Callable[[], Sequence[Taken]]
    """Returns them, newest last; it may return fewer than promised."""
    samples: int
    """How many there will be at most."""


_NOTHING = Promise(list, 0)


class Outbox:
    """Bounded queue of samples: when it is full, the oldest are dropped and counted."""

    def __init__(self, max_samples: int, name: str) -> None:
        self.dropped = 0
        """Samples that will never be delivered."""
        self._max_samples = max_samples
        self._waiting: deque[Taken] = deque()
        self._promised = _NOTHING
        """The newest samples."""
        self._changed = asyncio.Event()
        self._closed = asyncio.Event()
        self._tally = Tally(_log, f"{name}: %d samples dropped")

    def __len__(self) -> int:
        return len(self._waiting) + self._promised.samples

    @property
    def is_closed(self) -> bool:
        """Whether no more samples will come."""
        return self._closed.is_set()

    def promise(self, promise: Promise) -> None:
        """Announce samples, in place of those that are promised so far; these are among them."""
        self._promised = promise
        self._changed.set()

    def put(self, samples: Sequence[Taken]) -> None:
        """Add samples, newest last."""
        self._waiting.extend(samples)
        self._trim()
        self._changed.set()

    def take(self, max_samples: int) -> list[Taken]:
        """Remove and return up to `max_samples` samples, oldest first."""
        self.settle()
        return [self._waiting.popleft() for _ in range(min(max_samples, len(self._waiting)))]

    def settle(self) -> None:
        """Make the promised samples."""
        promised, self._promised = self._promised, _NOTHING
        if promised.samples:
            self.put(promised.make())

    def put_back(self, samples: Sequence[Taken]) -> None:
        """Put undelivered samples back at the front; if there is no room, the oldest are dropped."""
        self._waiting.extendleft(reversed(samples))
        self._trim()
        self._changed.set()

    def drop(self, number: int) -> None:
        """Count taken samples that cannot be delivered as dropped."""
        self.dropped += number
        self._tally.add(number)

    def close(self) -> None:
        """Announce that no more samples will come, and end all pauses."""
        self._closed.set()
        self._changed.set()

    async def filled(self) -> bool:
        """Wait until there is a sample; return False if the outbox is closed and empty."""
        while not len(self) and not self._closed.is_set():
            self._changed.clear()
            await self._changed.wait()
        return len(self) > 0

    async def pause(self, delay_s: float) -> None:
        """Wait for `delay_s`, or until closed."""
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(delay_s):
                await self._closed.wait()

    def _trim(self) -> None:
        excess = len(self._waiting) - self._max_samples
        if excess > 0:
            for _ in range(excess):
                self._waiting.popleft()
            self.drop(excess)
