"""Which samples are new, which came before, and which never came. Pure bookkeeping."""

from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass

MAX_SENDERS = 16
"""Boot ids to remember. A sender has one per start, so this outlives any retry of an earlier run."""


@dataclass(frozen=True)
class Admission:
    """What became of one batch; counts of samples."""

    accepted: int
    repeated: int
    lost: int
    """Missing between the last sample known of this sender and the last of the batch."""


class SequenceLog:
    """The last sequence number of each sender, of a bounded number of senders."""

    def __init__(self, max_senders: int = MAX_SENDERS) -> None:
        self._last: OrderedDict[str, int] = OrderedDict()
        self._max_senders = max_senders

    def admit(self, boot_id: str, sequences: Sequence[int]) -> Admission:
        """Note the increasing `sequences` of a batch and say which part of it was new.

        The first batch of a sender cannot show a loss: the sender may have started long before the service.
        """
        last = self._last.get(boot_id)
        new = [sequence for sequence in sequences if last is None or sequence > last]
        repeated = len(sequences) - len(new)
        if not new:
            return Admission(accepted=0, repeated=repeated, lost=0)
        self._last[boot_id] = new[-1]
        self._last.move_to_end(boot_id)
        if len(self._last) > self._max_senders:
            self._last.popitem(last=False)
        before = new[0] - 1 if last is None else last
        return Admission(accepted=len(new), repeated=repeated, lost=new[-1] - before - len(new))
