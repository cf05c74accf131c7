"""The log of one boot: all samples of a surface that the record does not have yet, in memory and in chunks on disk."""

import asyncio
import logging
import math
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, fields
from itertools import chain, groupby, islice, takewhile
from time import monotonic
from typing import Literal, NamedTuple, Self

from beamtouch_daemon.faults import Tally
from beamtouch_daemon.processing.pipeline import Taken
from beamtouch_service.samples import MAX_SAMPLES, Batch, Note, Receipt

MAX_BATCH = min(1000, MAX_SAMPLES)
MAX_BATCH_VALUES = 40_000
"""Limits of samples and of values, covariances included, in one batch: under half of the MiB that is accepted."""
_ENDED = 2**53
"""Beyond all numbers."""
_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Sender:
    """The origin of samples."""

    boot_id: str
    channels: list[str]
    noise_mm: list[float] | None = None
    """Standard deviation of one reading of each channel, if it is known."""
    characteristic: str | None = None
    """Identity of the characteristics and rest gaps."""
    beam: str | None = None
    """Identity of the beam and layout, if the configuration states it."""

    @classmethod
    def of(cls, batch: Batch) -> Self:
        """Return the sender of a batch."""
        return cls(**{field.name: getattr(batch, field.name) for field in fields(cls)})

    @property
    def max_samples(self) -> int:
        """Limit of samples in a batch."""
        channels = len(self.channels)
        return min(MAX_BATCH, MAX_BATCH_VALUES // (channels + channels * (channels + 1) // 2))

    def batch(self, samples: Sequence[Taken]) -> Batch:
        """Return a backlog of samples with the same notes. The service validates it."""
        notes: list[Literal["rate"]] = ["rate"] if samples and Note.RATE in samples[0].notes else []
        return Batch.model_construct(**vars(self), samples=[one.sample for one in samples], notes=notes, backlog=True)


class Chunk(NamedTuple):
    """Samples in one row of the file, without a gap."""

    row: int
    first: int
    last: int


class Counts:
    """Samples of one surface since the daemon started."""

    def __init__(self, surface: str) -> None:
        self.published = 0
        """Durable in the record."""
        self.dropped = 0
        """Discarded: for lack of room, refused alone, or lost with the file."""
        self._tally = Tally(_log, f"{surface}: %d samples dropped")

    def drop(self, number: int) -> None:
        """Count samples that never reach the record."""
        self.dropped += number
        self._tally.add(number)


class Log:
    """Samples of one boot, numbered from 1 on. The oldest are in chunks of the file, the others in memory."""

    def __init__(self, sender: Sender, counts: Counts, max_samples: int) -> None:
        self.sender = sender
        self.counts = counts
        self.max_samples = max_samples
        """Limit in memory; beyond it the oldest are dropped."""
        self.next = 1
        """Number of the next sample."""
        self.unsent = 1
        """Number of the first sample that no live batch has brought."""
        self.fresh = asyncio.Event()
        """Set when there are new samples for a live batch."""
        self.flying: int | None = None
        """Number of the first sample of the live batch that is on its way."""
        self.told_s = -math.inf
        """Time of the last receipt on the monotonic clock."""
        self.expected: int | None = None
        """Number of the sample that the record takes next, as far as is known."""
        self.refusal = ""
        """Why the service refuses this boot; empty if it does not."""
        self.on_disk = 0
        """Samples in chunks."""
        self.forgotten: list[int] = []
        """Rows that need not be kept any longer."""
        self._over = 0
        """Number of the last sample that is durable, or was dropped from memory."""
        self._chunks: deque[Chunk] = deque()
        self._memory: deque[Taken] = deque()
        self._refused: set[int] = set()

    def __len__(self) -> int:
        return self.on_disk + len(self._memory) - len(self._refused)

    @property
    def in_memory(self) -> int:
        """Number of samples in memory."""
        return len(self._memory)

    @property
    def oldest(self) -> int:
        """Number of the oldest sample that is left; that of the next one if there is none."""
        for first, last in self._stretches():
            number = first
            while number in self._refused:
                number += 1
            if number <= last:
                return number
        return self.next

    @property
    def lacking(self) -> int | None:
        """Number of the sample that the record takes next; None while that is unknown."""
        return None if self.expected is None else max(self.expected, self.oldest)

    @property
    def brought(self) -> int:
        """Number of the first sample that a live batch is bringing, or will bring."""
        return self.unsent if self.flying is None else self.flying

    @property
    def is_behind(self) -> bool:
        """Whether the record lacks a sample that no live batch will bring."""
        number = self.lacking
        return number is not None and number < self.brought and number not in self._refused

    def end(self) -> None:
        """Leave all samples to the backlog."""
        self.unsent, self.flying = _ENDED, None

    def put(self, samples: Sequence[Taken]) -> None:
        """Add samples with the next numbers; without room, drop the oldest in memory."""
        self._memory.extend(samples)
        self.next += len(samples)
        self._drop_memory(len(self._memory) - self.max_samples)

    def told(self, receipt: Receipt) -> None:
        """Forget what is durable. Receipts may come late, so that only ever grows."""
        self.told_s = monotonic()
        self.expected = receipt.expected
        if receipt.durable is not None:
            self.counts.published += self._forget(receipt.durable)

    def refuse(self, number: int) -> None:
        """Drop a single sample."""
        self._refused.add(number)
        self.counts.drop(1)

    def for_live(self, most: int) -> list[Taken]:
        """Return new samples for a live batch; those that do not fit in it are left to the backlog."""
        first = max(self.unsent, self.next - min(most, len(self._memory)))
        samples = self.memory_from(first, most)
        self.unsent = samples[-1].sample.sequence + 1 if samples else self.next
        return samples

    def memory_from(self, first: int, most: int) -> list[Taken]:
        """Return samples in memory from a number on, as far as they may go in one batch."""
        begin = first - (self.next - len(self._memory))
        if begin < 0:
            return []
        samples = takewhile(
            lambda one: one.sample.sequence not in self._refused, islice(self._memory, begin, begin + most)
        )
        return next(alike(samples), [])

    def chunk_of(self, number: int) -> Chunk | None:
        """Return the chunk with a sample."""
        return next((chunk for chunk in self._chunks if chunk.first <= number <= chunk.last), None)

    def part_of(self, batch: Batch, first: int, most: int) -> Batch:
        """Return the samples of a chunk from a number on."""
        samples = [one for one in batch.samples if one.sequence >= first][:most]
        samples = list(takewhile(lambda one: one.sequence not in self._refused, samples))
        return batch.model_copy(update={"samples": samples})

    def pieces(self, max_age_s: float | None, now_s: float) -> list[list[Taken]]:
        """Return the samples in memory, in pieces for one chunk each, if they should be on disk.

        They should if the oldest is older than `max_age_s` or memory is half full; None: now, in any case. Otherwise
        new ones are left for a live batch.
        """
        if not self._memory:
            return []
        number = len(self._memory)
        if max_age_s is not None:
            if now_s - self._memory[0].monotonic_s < max_age_s and number < self.max_samples / 2:
                return []
            number -= max(0, self.next - max(self.unsent, self.next - number))
        return [
            run[begin : begin + self.sender.max_samples]
            for run in alike(islice(self._memory, number))
            for begin in range(0, len(run), self.sender.max_samples)
        ]

    def adopt(self, chunk: Chunk) -> None:
        """Take over a chunk that the file holds; what is in it need not be in memory."""
        while self._memory and self._memory[0].sample.sequence <= chunk.last:
            self._memory.popleft()
        self.next = max(self.next, chunk.last + 1)
        # Some may have become durable, or have been dropped, while they were written.
        first = max(chunk.first, self._over + 1, self._chunks[-1].last + 1 if self._chunks else 1)
        if first <= chunk.last:
            self._chunks.append(chunk._replace(first=first))
            self.on_disk += chunk.last - first + 1
        else:
            self.forgotten.append(chunk.row)

    def lose(self, row: int | None = None) -> None:
        """Drop the samples of a row that the file no longer holds; None: of all rows."""
        lost = [chunk for chunk in self._chunks if row in {None, chunk.row}]
        self.forgotten = [] if row is None else [one for one in self.forgotten if one != row]
        left = len(self)
        for chunk in lost:
            self._chunks.remove(chunk)
            self.on_disk -= chunk.last - chunk.first + 1
            self._refused -= set(range(chunk.first, chunk.last + 1))
        self.counts.drop(left - len(self))

    def give_up(self) -> int:
        """Drop the samples in memory; return their number."""
        number = len(self._memory)
        self._drop_memory(number)
        return number

    def _drop_memory(self, number: int) -> None:
        if number > 0:
            left = len(self)
            self._over = [self._memory.popleft() for _ in range(number)][-1].sample.sequence
            self._refused = {one for one in self._refused if one > self._over or self.chunk_of(one)}
            self.counts.drop(left - len(self))

    def _forget(self, last: int) -> int:
        """Forget samples up to a number; return how many there were."""
        left = len(self)
        self._over = max(self._over, last)
        while self._chunks and self._chunks[0].first <= last:
            chunk = self._chunks.popleft()
            self.on_disk -= min(chunk.last, last) - chunk.first + 1
            if chunk.last > last:
                self._chunks.appendleft(chunk._replace(first=last + 1))
                break
            self.forgotten.append(chunk.row)
        while self._memory and self._memory[0].sample.sequence <= last:
            self._memory.popleft()
        self._refused = {number for number in self._refused if number > last}
        return left - len(self)

    def _stretches(self) -> Iterator[tuple[int, int]]:
        """Return the first and the last number of each stretch without a gap."""
        memory = (self.next - len(self._memory), self.next - 1)
        return chain(((chunk.first, chunk.last) for chunk in self._chunks), [memory] if self._memory else [])


def alike(samples: Iterable[Taken]) -> Iterator[list[Taken]]:
    """Yield the samples in runs with the same notes, as a batch has them once."""
    for _, run in groupby(samples, lambda one: one.notes):
        yield list(run)
