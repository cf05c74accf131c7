"""The new samples of a batch, and those of them that move the answer. Pure."""

from dataclasses import dataclass

from beamtouch_service.samples import Batch, Sample
from beamtouch_service.surfaces.senders import Senders
from beamtouch_service.surfaces.sequence_log import SequenceLog
from beamtouch_service.surfaces.summary import SampleCounts


@dataclass(frozen=True, slots=True)
class Taken:
    """The new samples of a batch."""

    accepted: int
    repeated: int
    fresh: list[Sample]
    """They move the answer, in order."""
    acquired_s: float
    """Time of the last sample of the batch [s, monotonic]."""


class Intake:
    """The batches of one surface."""

    def __init__(self, stale_ms: float) -> None:
        self.counts = SampleCounts()
        """Counts of samples since the start."""
        self.senders = Senders(stale_ms)
        self._sequences = SequenceLog()

    def moves_answer(self, batch: Batch, arrival_s: float) -> bool:
        """Return whether the last sample of a batch that arrived at `arrival_s` [s, monotonic] moves the answer."""
        return bool(batch.samples) and self._is_after_newest(batch, batch.samples[-1], arrival_s)

    def take(self, batch: Batch, arrival_s: float) -> Taken:
        """Take a batch that arrived at `arrival_s` [s, monotonic]."""
        if not batch.samples:
            return Taken(0, 0, [], arrival_s)
        admission = self._sequences.admit(batch.boot_id, [sample.sequence for sample in batch.samples])
        self.counts.accepted += admission.accepted
        self.counts.repeated += admission.repeated
        self.counts.lost += admission.lost
        acquired_s = _acquired_s(batch, arrival_s)
        # Sequence numbers increase, so the samples after the newest one are the last of the batch.
        new, fresh = set(admission.new), batch.samples
        if admission.repeated or not self._is_after_newest(batch, fresh[0], arrival_s):
            fresh = [one for one in fresh if one.sequence in new and self._is_after_newest(batch, one, arrival_s)]
        if fresh:
            self.senders.move(batch.boot_id, fresh[-1].sequence, acquired_s)
        return Taken(admission.accepted, admission.repeated, fresh, acquired_s)

    def _is_after_newest(self, batch: Batch, sample: Sample, arrival_s: float) -> bool:
        if batch.backlog:
            return False
        return self.senders.is_after_newest(batch.boot_id, sample.sequence, _acquired_s(batch, arrival_s), arrival_s)


def _acquired_s(batch: Batch, arrival_s: float) -> float:
    return arrival_s - (batch.newest_age_ms or 0.0) / 1e3
