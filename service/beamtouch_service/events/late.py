"""Late samples: decided run by run, from the state of the samples beside the gap that they fill."""

from collections import OrderedDict
from collections.abc import Iterable
from itertools import pairwise

from beamtouch_models.modelfile import State
from beamtouch_service.events.segmenter import Command, Edge, Segmenter, segment_late_run
from beamtouch_service.events.segments import End
from beamtouch_service.events.store import EventStore
from beamtouch_service.samples import Batch, Sample
from beamtouch_service.surfaces.estimates import estimate, runner
from beamtouch_service.surfaces.served_model import ServedModel
from beamtouch_service.surfaces.touch import Follower

_MAX_EDGES = 4096
"""Edges in memory, some 0.5 MB; without its edge, a late run starts clear or from the stored event before it."""


class LateSamples:
    """Makes segments from late samples. Only the worker thread uses it."""

    def __init__(self, store: EventStore) -> None:
        self._store = store
        self._edges: OrderedDict[tuple[str, str, int], Edge] = OrderedDict()

    def remember(self, surface: str, edges: Iterable[Edge]) -> None:
        """Keep the samples beside gaps."""
        for edge in edges:
            self._edges[surface, edge.boot_id, edge.sequence] = edge
        while len(self._edges) > _MAX_EDGES:
            self._edges.popitem(last=False)

    def segment(
        self, surface: str, stale_ms: float, served: ServedModel, batch: Batch, samples: list[Sample]
    ) -> list[Command | Edge]:
        """Return the commands for the late samples of a batch, in order; a state outlasts gaps up to `stale_ms`."""
        estimates = estimate(served.file, surface, batch, samples)
        gaps = [i + 1 for i, (one, other) in enumerate(pairwise(estimates)) if other.sequence != one.sequence + 1]
        commands: list[Command | Edge] = []
        for begin, end in pairwise([0, *gaps, len(estimates)]):
            run = estimates[begin:end]
            before = self._state(surface, batch.boot_id, run[0].sequence - 1)
            follower = Follower(served.file, runner(served.file), surface, stale_ms, state=before or State.CLEAR)
            after = self._edges.get((surface, batch.boot_id, run[-1].sequence + 1))
            # Only new samples open an event.
            segmenter = Segmenter(surface, served.file, batch.boot_id, before, End.UNSEEN)
            commands += segment_late_run(segmenter, map(follower.step, run), after)
        return commands

    def _state(self, surface: str, boot_id: str, sequence: int) -> State | None:
        edge = self._edges.get((surface, boot_id, sequence))
        if edge:
            return edge.state
        return self._store.state_after(surface, boot_id, sequence)
