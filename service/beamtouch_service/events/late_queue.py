"""Late samples that wait for the worker thread, within bounds."""

from beamtouch_models.modelfile import ModelFile
from beamtouch_service.events.late import LateSamples
from beamtouch_service.events.losses import Losses
from beamtouch_service.events.worker import Worker
from beamtouch_service.events.writer import Writer
from beamtouch_service.samples import Batch, Sample
from beamtouch_service.surfaces.surface import Surface

MAX_LATE = 20_000
"""Late samples that may wait: about a second of work, and some 20 MB."""


class LateQueue:
    """Admits late samples, and lets the worker thread decide and write them."""

    def __init__(self, worker: Worker, writer: Writer, late: LateSamples, losses: Losses) -> None:
        self._worker, self._writer, self._late, self._losses = worker, writer, late, losses
        # Counts of samples, each changed by one thread only.
        self._added = self._done = 0

    @property
    def waiting(self) -> int:
        """Samples that are not written yet."""
        return self._added - self._done

    def has_room(self, samples: int) -> bool:
        """Return whether this many more may wait: none while a database is away, as senders keep them."""
        return not self._writer.is_away and self.waiting + samples <= MAX_LATE

    def add(self, surface: Surface, model: ModelFile, batch: Batch, samples: list[Sample]) -> None:
        """Record late samples of a batch, in order."""
        # A batch with a new sample is accepted above the limit, but not without end.
        if self.waiting > 2 * MAX_LATE:
            self._losses.note("late samples come faster than they can be recorded")
            return
        name, stale_ms = surface.name, surface.stale_ms
        self._added += len(samples)

        def run() -> None:
            self._writer.write_late(name, lambda: self._late.segment(name, stale_ms, model, batch, samples))
            self._done += len(samples)

        self._worker.late(run)
