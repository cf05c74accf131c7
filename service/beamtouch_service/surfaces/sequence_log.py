"""Bookkeeping of sequence numbers: new, repeated and missing samples. Pure."""

from bisect import bisect_right
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

MAX_SENDERS = 16
"""Boot ids to remember. A sender has a new one per start, so this covers retries from earlier runs."""
MAX_RUNS = 1000
"""Runs without a gap to remember per sender. Beyond this, the oldest gap counts as permanently lost."""


@dataclass(frozen=True)
class Admission:
    """Result of one batch; counts of samples."""

    accepted: int
    repeated: int
    lost: int
    """Change in the number of missing samples between the first and the last of this sender; negative if a gap was
    filled."""
    new: tuple[int, ...] = field(default=(), compare=False)
    """Sequence numbers of the new samples, increasing."""


class Runs:
    """A set of numbers, stored as runs of consecutive numbers."""

    def __init__(self, max_runs: int = MAX_RUNS) -> None:
        self._begins: list[int] = []
        self._ends: list[int] = []
        """One beyond the last of each run."""
        self._max_runs = max_runs
        self._given_up = 0
        """Missing numbers in gaps that are forgotten. They never count as new."""

    @property
    def missing(self) -> int:
        """Count of numbers between the first and the last that were never added."""
        return self._given_up + sum(begin - end for begin, end in zip(self._begins[1:], self._ends, strict=False))

    def __contains__(self, number: int) -> bool:
        index = bisect_right(self._begins, number) - 1
        return index >= 0 and number < self._ends[index]

    def extend(self, begin: int, end: int) -> bool:
        """Add the numbers from `begin` to before `end` if they follow the last one; return whether they do."""
        if not self._ends or self._ends[-1] != begin:
            return False
        self._ends[-1] = end
        return True

    def add(self, begin: int, end: int) -> None:
        """Add the numbers from `begin` up to, but without, `end`. None of them may be in the set."""
        index = bisect_right(self._begins, begin)
        if index and self._ends[index - 1] == begin:
            index -= 1
            self._ends[index] = end
        else:
            self._begins.insert(index, begin)
            self._ends.insert(index, end)
        if index + 1 < len(self._begins) and self._begins[index + 1] == end:
            del self._begins[index + 1], self._ends[index]
        if len(self._begins) > self._max_runs:
            self._given_up += self._begins[1] - self._ends[0]
            del self._begins[1], self._ends[0]


class SequenceLog:
    """The sequence numbers of each sender, for a bounded number of senders."""

    def __init__(self, max_senders: int = MAX_SENDERS) -> None:
        self._runs: OrderedDict[str, Runs] = OrderedDict()
        self._max_senders = max_senders

    def admit(self, boot_id: str, sequences: Sequence[int]) -> Admission:
        """Note the increasing `sequences` of a batch and return which are new.

        They may be older than others that came before: a sender delivers new samples first and spooled ones later. The
        first batch of a sender cannot show a loss, because the sender may have started long before the service.
        """
        runs = self._runs.setdefault(boot_id, Runs())
        self._runs.move_to_end(boot_id)
        if len(self._runs) > self._max_senders:
            self._runs.popitem(last=False)
        if sequences[-1] - sequences[0] == len(sequences) - 1 and runs.extend(sequences[0], sequences[-1] + 1):
            return Admission(accepted=len(sequences), repeated=0, lost=0, new=tuple(sequences))
        missing = runs.missing
        new = [sequence for sequence in sequences if sequence not in runs]
        cuts = [0, *(index + 1 for index, (one, other) in enumerate(pairwise(new)) if other != one + 1), len(new)]
        for first, last in pairwise(cuts):
            if last > first:
                runs.add(new[first], new[last - 1] + 1)
        lost = runs.missing - missing
        return Admission(accepted=len(new), repeated=len(sequences) - len(new), lost=lost, new=tuple(new))
