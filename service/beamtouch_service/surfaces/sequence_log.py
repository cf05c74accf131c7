"""Which samples are new, which came before, and which never came. Pure bookkeeping."""

from bisect import bisect_right
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

MAX_SENDERS = 16
"""Boot ids to remember. A sender has one per start, so this outlives any retry of an earlier run."""
MAX_RUNS = 1000
"""Runs of samples without a gap to remember of each sender; of more, the oldest gap is never filled any more."""


@dataclass(frozen=True)
class Admission:
    """What became of one batch; counts of samples."""

    accepted: int
    repeated: int
    lost: int
    """By how many more samples are missing now between the first and the last of this sender; negative where a gap was
    filled."""
    new: tuple[int, ...] = field(default=(), compare=False)
    """The sequence numbers of those that are new, increasing."""


class Runs:
    """A set of numbers, kept as runs of numbers in a row."""

    def __init__(self, most: int = MAX_RUNS) -> None:
        self._begins: list[int] = []
        self._ends: list[int] = []
        """One beyond the last of each run."""
        self._most = most
        self._given_up = 0
        """How many numbers are missing in gaps that are not remembered: they never count as new any more."""

    @property
    def missing(self) -> int:
        """How many numbers between the first and the last were never added."""
        return self._given_up + sum(begin - end for begin, end in zip(self._begins[1:], self._ends, strict=False))

    def __contains__(self, number: int) -> bool:
        index = bisect_right(self._begins, number) - 1
        return index >= 0 and number < self._ends[index]

    def add(self, begin: int, end: int) -> None:
        """Add the numbers from `begin` up to but not with `end`, none of which is in the set."""
        index = bisect_right(self._begins, begin)
        if index and self._ends[index - 1] == begin:
            index -= 1
            self._ends[index] = end
        else:
            self._begins.insert(index, begin)
            self._ends.insert(index, end)
        if index + 1 < len(self._begins) and self._begins[index + 1] == end:
            del self._begins[index + 1], self._ends[index]
        if len(self._begins) > self._most:
            self._given_up += self._begins[1] - self._ends[0]
            del self._begins[1], self._ends[0]


class SequenceLog:
    """The sequence numbers that came from each sender, of a bounded number of senders."""

    def __init__(self, max_senders: int = MAX_SENDERS) -> None:
        self._runs: OrderedDict[str, Runs] = OrderedDict()
        self._max_senders = max_senders

    def admit(self, boot_id: str, sequences: Sequence[int]) -> Admission:
        """Note the increasing `sequences` of a batch and say which part of it was new.

        They may be older than others that came before: a sender delivers the present first, and what it could not
        deliver then later. The first batch of a sender cannot show a loss: it may have started long before the service.
        """
        runs = self._runs.setdefault(boot_id, Runs())
        self._runs.move_to_end(boot_id)
        if len(self._runs) > self._max_senders:
            self._runs.popitem(last=False)
        missing = runs.missing
        new = [sequence for sequence in sequences if sequence not in runs]
        cuts = [0, *(index + 1 for index, (one, other) in enumerate(pairwise(new)) if other != one + 1), len(new)]
        for first, last in pairwise(cuts):
            if last > first:
                runs.add(new[first], new[last - 1] + 1)
        lost = runs.missing - missing
        return Admission(accepted=len(new), repeated=len(sequences) - len(new), lost=lost, new=tuple(new))
