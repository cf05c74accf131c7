"""The log of one boot: all samples of a surface that the record does not have yet, in memory and in chunks on disk."""

import asyncio
import logging
import math
from collections import deque
from collections.abc import Iterable, Iterator, Sequence, Set
from itertools import groupby, islice
from time import monotonic

from beamtouch_common.log import Repeated
from beamtouch_common.waits import Backoff
from beamtouch_daemon.delivery.log_file import Chunk
from beamtouch_daemon.processing.pipeline import Taken
from beamtouch_service.samples import MAX_SAMPLES, Batch, Receipt

MAX_BATCH = min(250, MAX_SAMPLES)
MAX_BATCH_VALUES = 40_000
"""Limits of samples and of values, covariances included, in one batch: under half of the MiB that is accepted. With
1000 samples, answers beside a backlog took 43 ms at p99 instead of 18, as they wait while the service reads a batch."""
BACKLOG_RETRY_S = 5.0
"""Longest wait of the backlog after a request that brought the record no further."""
_ENDED = 2**53
"""Beyond all numbers."""
_log = logging.getLogger(__name__)


class Counts:
    """Samples of one surface since the daemon started."""

    def __init__(self, surface: str) -> None:
        self.published = 0
        """Durable in the record."""
        self.dropped = 0
        """Discarded: for lack of room, refused alone, or lost with the file."""
        self._repeated = Repeated(_log, surface)

    def drop(self, number: int) -> None:
        """Count samples that never reach the record."""
        self.dropped += number
        self._repeated.count(number, "samples dropped")


class Log:
    """Samples of one boot, numbered from 1 on. The oldest are in chunks of the file, the others in memory.

    Parameters
    ----------
    head : what all batches of the boot state, and no samples
    counts : the counts of the surface
    max_samples : limit of the samples in memory
    """

    def __init__(self, head: Batch, counts: Counts, max_samples: int) -> None:
        channels = len(head.channels)
        self.head = head
        self.counts = counts
        self.max_batch = min(MAX_BATCH, MAX_BATCH_VALUES // (channels + channels * (channels + 1) // 2))
        """Limit of samples in a batch."""
        self.next = 1
        """Number of the next sample."""
        self.fresh = asyncio.Event()
        """Set when there are new samples for a live batch."""
        self.live_from = 1
        """Number of the first sample that a live batch is bringing, or will bring."""
        self.refusal = ""
        """Why the service refuses this boot; empty if it does not."""
        self.stale_ms: float | None = None
        """After this time an answer is stale, by the last receipt [ms]; None before the first."""
        self.told_s = -math.inf
        """Time of the last receipt on the monotonic clock."""
        self.due_s = 0.0
        """Time of the next request of the backlog on the monotonic clock, at the earliest."""
        self.backoff = Backoff(max_s=BACKLOG_RETRY_S)
        self.most = self.max_batch
        """Limit of samples in the next batch of the backlog."""
        self._max_samples = max_samples
        self._expected: int | None = None
        self._over = 0
        """Number of the last sample that is durable, or was dropped from memory."""
        self._refused = _ENDED
        """Number of a sample that was refused alone; it is dropped once all before it are durable."""
        self._chunks: deque[Chunk] = deque()
        self._memory: deque[Taken] = deque()

    @property
    def is_empty(self) -> bool:
        """Whether the record has all samples."""
        return not self._chunks and not self._memory

    @property
    def in_memory(self) -> int:
        """Number of samples in memory."""
        return len(self._memory)

    @property
    def on_disk(self) -> int:
        """Number of samples in chunks."""
        return sum(chunk.last - chunk.first + 1 for chunk in list(self._chunks))

    @property
    def rows(self) -> set[int]:
        """Rows of the file that hold samples of this log."""
        return {chunk.row for chunk in self._chunks}

    @property
    def oldest(self) -> int:
        """Number of the oldest sample that is left; that of the next one if there is none."""
        return self._chunks[0].first if self._chunks else self.next - len(self._memory)

    @property
    def missing(self) -> range:
        """Numbers of the samples that the record lacks and no live batch will bring; empty while that is unknown."""
        first = _ENDED if self._expected is None else max(self._expected, self.oldest)
        return range(first, min(self.live_from, self._refused, self.next))

    def batch(self, samples: Sequence[Taken]) -> Batch:
        """Return a backlog of samples with the same notes. The service validates it."""
        notes = [str(note) for note in samples[0].notes] if samples else []
        update = {"samples": [one.sample for one in samples], "notes": notes, "backlog": True}
        return self.head.model_copy(update=update)

    def put(self, samples: Sequence[Taken]) -> None:
        """Add samples with the next numbers; without room, drop the oldest in memory."""
        self._memory.extend(samples)
        self.next += len(samples)
        self._drop_memory(len(self._memory) - self._max_samples)

    def told(self, receipt: Receipt) -> None:
        """Forget what is durable. Receipts may come late, so that only ever grows."""
        self.told_s = monotonic()
        self.stale_ms = receipt.stale_ms
        self.refusal = ""
        self._expected = receipt.expected
        if receipt.durable is not None:
            self.counts.published += self._forget(receipt.durable)
            self._drop_refused()

    def refuse(self, number: int) -> None:
        """Drop a single sample, as soon as all before it are durable."""
        self._refused = number
        self._drop_refused()

    def end(self) -> None:
        """Leave all samples to the backlog, which asks first: a last live batch may have arrived without an answer."""
        self.live_from, self._expected = _ENDED, None

    def for_live(self) -> list[Taken]:
        """Return new samples for a live batch; those that do not fit in it are left to the backlog."""
        self.live_from = max(self.live_from, self.next - min(self.max_batch, len(self._memory)))
        return self.from_memory(range(self.live_from, self.next))

    def from_memory(self, numbers: range) -> list[Taken]:
        """Return the samples in memory with these numbers, as far as they may go in one batch."""
        begin = numbers.start - (self.next - len(self._memory))
        if begin < 0:
            return []
        return next(_runs(islice(self._memory, begin, begin + len(numbers)), len(numbers)), [])

    def chunk_of(self, number: int) -> Chunk | None:
        """Return the chunk with a sample."""
        return next((chunk for chunk in self._chunks if chunk.first <= number <= chunk.last), None)

    def for_disk(self, max_age_s: float | None, now_s: float) -> list[list[Taken]]:
        """Return the samples in memory, in pieces for one chunk each, if they should be on disk.

        They should if the oldest is older than `max_age_s` or memory is half full; None: now, in any case. Otherwise
        new ones are left for a live batch.
        """
        number = len(self._memory)
        if max_age_s is not None and number:
            if now_s - self._memory[0].monotonic_s < max_age_s and number < self._max_samples / 2:
                return []
            number = max(0, min(number, self.live_from - (self.next - number)))
        return list(_runs(islice(self._memory, number), self.max_batch))

    def adopt(self, chunk: Chunk) -> None:
        """Take over a chunk that the file holds; what is in it need not be in memory."""
        while self._memory and self._memory[0].sample.sequence <= chunk.last:
            self._memory.popleft()
        self.next = max(self.next, chunk.last + 1)
        # Some may have become durable, or have been dropped, while they were written.
        first = max(chunk.first, self._over + 1, self._chunks[-1].last + 1 if self._chunks else 1)
        if first <= chunk.last:
            self._chunks.append(chunk._replace(first=first))

    def keep(self, rows: Set[int]) -> None:
        """Drop the samples on disk that are not in these rows."""
        held = self.on_disk
        self._chunks = deque(chunk for chunk in self._chunks if chunk.row in rows)
        self.counts.drop(held - self.on_disk)

    def give_up(self) -> int:
        """Drop the samples in memory; return their number."""
        number = len(self._memory)
        self._drop_memory(number)
        return number

    def _drop_memory(self, number: int) -> None:
        if number > 0:
            self._over = [self._memory.popleft() for _ in range(number)][-1].sample.sequence
            self.counts.drop(number)

    def _drop_refused(self) -> None:
        if self._refused <= self.oldest:
            self.counts.drop(self._forget(self._refused))
            self._refused = _ENDED

    def _forget(self, last: int) -> int:
        """Forget samples up to a number; return how many there were."""
        number = 0
        self._over = max(self._over, last)
        while self._chunks and self._chunks[0].first <= last:
            chunk = self._chunks.popleft()
            number += min(chunk.last, last) - chunk.first + 1
            if chunk.last > last:
                self._chunks.appendleft(chunk._replace(first=last + 1))
        while self._memory and self._memory[0].sample.sequence <= last:
            self._memory.popleft()
            number += 1
        return number


def _runs(samples: Iterable[Taken], most: int) -> Iterator[list[Taken]]:
    """Yield samples in runs for one batch each: at most so many, and with the same notes."""
    for _, alike in groupby(samples, lambda one: one.notes):
        while run := list(islice(alike, most)):
            yield run
