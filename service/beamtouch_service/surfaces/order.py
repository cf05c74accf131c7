"""The order of the samples of one surface: which are new, and which move the answer. Pure: no clock."""

from bisect import bisect_right
from collections import OrderedDict
from dataclasses import dataclass

from pydantic import BaseModel

from beamtouch_service.samples import Batch, Sample

MAX_SENDERS = 16
"""Boot ids to remember. A sender has a new one per start, so this covers what earlier starts left in the log."""
MAX_RUNS = 1000
"""Runs without a gap to remember per sender. Beyond this, the oldest gap counts as lost for good."""
RETURNS = 4
"""Times that a sender must come back after another one before there are two. A batch that was held up on its way when
the sender was restarted comes back once."""
QUIET_S = 10.0
"""Without such a return for this long, or for several times the limit of age, there is one sender again."""


class SampleCounts(BaseModel):
    """Counts of samples since the service started."""

    accepted: int = 0
    repeated: int = 0
    """Received before; they changed nothing."""
    lost: int = 0
    """Gaps in the sequence numbers."""


@dataclass(frozen=True, slots=True)
class AcceptedSamples:
    """The new samples of a batch."""

    accepted: int
    repeated: int
    fresh: list[Sample]
    """They move the answer, in order."""
    acquired_s: float
    """Time of the last sample of the batch [s, monotonic]."""


class Order:
    """The batches of one surface."""

    def __init__(self, stale_ms: float) -> None:
        self.senders = Senders(stale_ms)
        self._numbers: OrderedDict[str, Runs] = OrderedDict()
        self._counts = SampleCounts()
        """Its losses are those of senders that are forgotten."""

    @property
    def counts(self) -> SampleCounts:
        """Counts of samples since the start."""
        lost = self._counts.lost + sum(runs.missing for runs in self._numbers.values())
        return self._counts.model_copy(update={"lost": lost})

    def moves_answer(self, batch: Batch, arrival_s: float) -> bool:
        """Return whether the last sample of a batch that arrived at `arrival_s` [s, monotonic] moves the answer."""
        return bool(batch.samples) and self._is_after_newest(batch, batch.samples[-1], arrival_s)

    def take(self, batch: Batch, arrival_s: float) -> AcceptedSamples:
        """Take a batch that arrived at `arrival_s` [s, monotonic]."""
        if not batch.samples:
            return AcceptedSamples(0, 0, [], arrival_s)
        runs = self._runs(batch.boot_id)
        new = [sample for sample in batch.samples if runs.add(sample.sequence)]
        repeated = len(batch.samples) - len(new)
        self._counts.accepted += len(new)
        self._counts.repeated += repeated
        fresh = [sample for sample in new if self._is_after_newest(batch, sample, arrival_s)]
        if fresh:
            self.senders.move(batch.boot_id, fresh[-1].sequence, _acquired_s(batch, arrival_s))
        return AcceptedSamples(len(new), repeated, fresh, _acquired_s(batch, arrival_s))

    def _runs(self, boot_id: str) -> "Runs":
        runs = self._numbers.setdefault(boot_id, Runs())
        self._numbers.move_to_end(boot_id)
        if len(self._numbers) > MAX_SENDERS:
            self._counts.lost += self._numbers.popitem(last=False)[1].missing
        return runs

    def _is_after_newest(self, batch: Batch, sample: Sample, arrival_s: float) -> bool:
        if batch.backlog:
            return False
        return self.senders.is_after_newest(batch.boot_id, sample.sequence, _acquired_s(batch, arrival_s), arrival_s)


def _acquired_s(batch: Batch, arrival_s: float) -> float:
    return arrival_s - (batch.newest_age_ms or 0.0) / 1e3


class Runs:
    """The numbers of one sender, stored as runs of consecutive numbers."""

    def __init__(self) -> None:
        self._begins: list[int] = []
        self._ends: list[int] = []
        """One beyond the last of each run."""
        self._given_up = 0
        """Missing numbers in gaps that are forgotten. They never count as new."""

    @property
    def missing(self) -> int:
        """Count of numbers between the first and the last that were never added."""
        return self._given_up + sum(begin - end for begin, end in zip(self._begins[1:], self._ends, strict=False))

    def add(self, number: int) -> bool:
        """Add a number; return whether it is new."""
        begins, ends = self._begins, self._ends
        place = bisect_right(begins, number)
        if place and number < ends[place - 1]:
            return False
        if place and ends[place - 1] == number:
            ends[place - 1] += 1
        else:
            begins.insert(place, number)
            ends.insert(place, number + 1)
            place += 1
        if place < len(begins) and begins[place] == number + 1:
            del begins[place], ends[place - 1]
        if len(begins) > MAX_RUNS:
            self._given_up += begins[1] - ends[0]
            del begins[1], ends[0]
        return True


@dataclass(frozen=True, slots=True)
class _Newest:
    """Sender, number and time of the newest sample."""

    boot_id: str
    sequence: int
    acquired_s: float


class Senders:
    """Decides which samples move the answer.

    A boot id identifies a sender. Samples from one sender are ordered by sequence number alone, which is exact: the
    time of a sample includes the delay of its batch. Samples from different senders are ordered by time. A sender that
    another one has replaced may return only once the newest sample is stale, in case the other one was a stray.
    """

    def __init__(self, stale_ms: float) -> None:
        self.changes = 0
        """Number of changes of the sender."""
        self._stale_ms = stale_ms
        self._newest: _Newest | None = None
        self._former: OrderedDict[str, int] = OrderedDict()
        """Sequence number of the last accepted newest sample of each replaced sender."""

    def is_after_newest(self, boot_id: str, sequence: int, acquired_s: float, arrival_s: float) -> bool:
        """Return whether a sample moves the answer.

        Parameters
        ----------
        boot_id, sequence : name the sample
        acquired_s, arrival_s : times of its acquisition and its arrival [s, monotonic]
        """
        newest = self._newest
        if newest is None:
            return True
        if boot_id == newest.boot_id:
            return sequence > newest.sequence
        if acquired_s < newest.acquired_s:
            return False
        if boot_id not in self._former:
            return True
        return (arrival_s - newest.acquired_s) * 1e3 > self._stale_ms and sequence > self._former[boot_id]

    def move(self, boot_id: str, sequence: int, acquired_s: float) -> None:
        """Make a sample the newest one."""
        if self._newest and self._newest.boot_id != boot_id:
            self.changes += 1
            self._former.pop(boot_id, None)
            self._former[self._newest.boot_id] = self._newest.sequence
            if len(self._former) > MAX_SENDERS:
                self._former.popitem(last=False)
        self._newest = _Newest(boot_id, sequence, acquired_s)


class DuplicateSenders:
    """Notices that two daemons send samples of one surface at the same time.

    A restarted daemon has a new boot id, and all samples of the old one are older than its first. So two
    send if, in turn, each sends a sample that is newer than the first one of the other.
    """

    def __init__(self, stale_ms: float) -> None:
        self._quiet_s = max(QUIET_S, 4 * stale_ms / 1e3)
        self._begun_s: OrderedDict[str, float] = OrderedDict()
        """Time of the first sample of each sender [s, monotonic], oldest first."""
        self._last = ("", "")
        """Boot id and address of the newest batch."""
        self._returns = 0
        self._returned_s = 0.0
        self._pair = ("", "")

    def note(self, boot_id: str, address: str, acquired_s: float) -> None:
        """Take a batch of this sender and address whose last sample was taken at `acquired_s` [s, monotonic]."""
        if any(begun_s > acquired_s for begun_s in self._begun_s.values()):
            return
        before, self._last = self._last, (boot_id, address)
        if boot_id == before[0]:
            return
        if boot_id not in self._begun_s:
            self._begun_s[boot_id] = acquired_s
            if len(self._begun_s) > MAX_SENDERS:
                self._begun_s.popitem(last=False)
            return
        self._returns = self._returns + 1 if acquired_s - self._returned_s < self._quiet_s else 1
        self._returned_s, self._pair = acquired_s, (before[1], address)

    def at(self, now_s: float) -> tuple[str, str] | None:
        """Return the addresses of two daemons that both send at `now_s` [s, monotonic]; None if one sends."""
        is_now = self._returns >= RETURNS and now_s - self._returned_s < self._quiet_s
        return self._pair if is_now else None
