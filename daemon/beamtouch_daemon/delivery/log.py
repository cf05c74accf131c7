"""The log of one boot: all samples of a surface that the record does not have yet, in memory and in chunks on disk."""

import logging
from collections import deque
from collections.abc import Iterable, Iterator, Sequence, Set
from itertools import groupby, islice

from beamtouch_common.log_lines import Repeated
from beamtouch_daemon.delivery.log_file import Chunk
from beamtouch_daemon.processing.pipeline import TimedSample
from beamtouch_service.samples import Batch, Sample

_logger = logging.getLogger(__name__)


class Counts:
    """Samples of one surface since the daemon started."""

    def __init__(self, surface: str) -> None:
        self.published = 0
        """Durable in the record."""
        self.dropped = 0
        """Discarded: for lack of room, refused alone, or lost with the file."""
        self._repeated = Repeated(_logger, surface)

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
        self.head = head
        self.next = 1
        """Number of the next sample."""
        self._counts = counts
        self._max_samples = max_samples
        self._over = 0
        """Number of the last sample that is durable, or was dropped from memory."""
        self._chunks: deque[Chunk] = deque()
        self._memory: deque[TimedSample] = deque()

    @property
    def is_empty(self) -> bool:
        """True if the record has all samples."""
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
        return self._chunks[0].first if self._chunks else self.oldest_in_memory

    @property
    def oldest_in_memory(self) -> int:
        """Number of the oldest sample in memory; that of the next one if there is none."""
        return self.next - len(self._memory)

    def batch(self, samples: Sequence[TimedSample]) -> Batch:
        """Return a backlog of samples with the same notes. The service validates it."""
        notes = [str(note) for note in next((timed.notes for timed in samples), ())]
        return self.backlog_batch([timed.sample for timed in samples], notes)

    def backlog_batch(self, samples: Sequence[Sample], notes: Sequence[str]) -> Batch:
        """Return a backlog of samples that were taken under these notes."""
        return self.head.model_copy(update={"samples": list(samples), "notes": list(notes), "backlog": True})

    def put(self, samples: Sequence[TimedSample]) -> None:
        """Add samples with the next numbers; without room, drop the oldest in memory."""
        self._memory.extend(samples)
        self.next += len(samples)
        self._drop_memory(len(self._memory) - self._max_samples)

    def from_memory(self, numbers: range) -> list[TimedSample]:
        """Return the samples in memory with these numbers, as far as they have the notes of the first one."""
        begin = numbers.start - self.oldest_in_memory
        if begin < 0 or not numbers:
            return []
        return next(_runs(islice(self._memory, begin, begin + len(numbers)), len(numbers)), [])

    def chunk_of(self, number: int) -> Chunk | None:
        """Return the chunk with a sample."""
        return next((chunk for chunk in self._chunks if chunk.first <= number <= chunk.last), None)

    def for_disk(self, max_age_s: float, now_s: float, before: int, most: int) -> list[list[TimedSample]]:
        """Return the samples in memory before a number, if they should be on disk: at most `most` for each chunk.

        They should if the oldest is older than `max_age_s`, or memory is half full.
        """
        number = len(self._memory)
        if not number or (now_s - self._memory[0].monotonic_s < max_age_s and number < self._max_samples / 2):
            return []
        number = max(0, min(number, before - self.oldest_in_memory))
        return list(_runs(islice(self._memory, number), most))

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
        self._counts.drop(held - self.on_disk)

    def give_up(self) -> int:
        """Drop the samples in memory; return their number."""
        number = len(self._memory)
        self._drop_memory(number)
        return number

    def forget(self, last: int) -> int:
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

    def _drop_memory(self, number: int) -> None:
        if number > 0:
            self._over = [self._memory.popleft() for _ in range(number)][-1].sample.sequence
            self._counts.drop(number)


def _runs(samples: Iterable[TimedSample], most: int) -> Iterator[list[TimedSample]]:
    """Yield samples in runs for one batch each: at most so many, and with the same notes."""
    for _, alike in groupby(samples, lambda timed: timed.notes):
        while run := list(islice(alike, most)):
            yield run
