"""Late samples: decided run by run, from the state of the samples beside the gap that they fill."""

from collections import OrderedDict
from collections.abc import Iterable
from contextlib import suppress
from itertools import pairwise

from beamtouch_models.modelfile import ModelFile, State, memories_after
from beamtouch_service.events.file import EventsAwayError
from beamtouch_service.events.findings import Command, Doubtful, Edge, Found, TouchSeen
from beamtouch_service.events.segmenter import Segmenter, segment_late_run
from beamtouch_service.events.segments import End
from beamtouch_service.events.store import EventStore
from beamtouch_service.samples import Batch, Sample
from beamtouch_service.surfaces.estimates import Estimated, estimate
from beamtouch_service.surfaces.follower import Follower, Past

_MAX_EDGES = 4096
"""Edges in memory, some 3 MB; without its edge, a late run starts from the stored event before it."""
_MAX_ASIDE = 10_000
"""Doubtful samples in memory, some 30 MB; without them, an event may stay in pieces."""

_MAX_AGAIN = 8
"""Doubtful samples of a surface that are tried again: the newest."""


class LateSamples:
    """Makes segments from late samples. Only the worker thread uses it."""

    def __init__(self, store: EventStore) -> None:
        self._store = store
        self._edges: OrderedDict[tuple[str, str, int], Edge] = OrderedDict()
        self._aside: OrderedDict[tuple[str, str, str, int], Doubtful] = OrderedDict()
        """Doubtful samples, by the number of the first."""
        self._aside_to: dict[tuple[str, str, str, int], int] = {}
        """Number of the last of them -> that of the first."""
        self._count = 0
        """Number of doubtful samples."""
        self._tried: dict[tuple[str, str, str, int], Past] = {}
        """What doubtful samples were decided from without success."""

    def commands_in(self, surface: str, stale_ms: float, found: Iterable[Found]) -> list[Command]:
        """Return the commands in what was found; keep the samples beside gaps, and decide doubtful ones if possible."""
        found = list(found)
        edges = [one for one in found if isinstance(one, Edge)]
        self._edges |= {(surface, one.boot_id, one.sequence): one for one in edges}
        while len(self._edges) > _MAX_EDGES:
            self._edges.popitem(last=False)
        # On record too: another service may have the other side of the gap.
        commands: list[Command] = [*edges]
        for one in found:
            if isinstance(one, Doubtful):
                commands += self._run(surface, stale_ms, one.model, one.boot_id, one.samples)
            elif not isinstance(one, Edge):
                commands.append(one)
        # The sample before the first of a stretch may have come while that was doubtful.
        befores = [self._edges.get((surface, one.boot_id, one.sequence - 1)) for one in edges]
        touches = [
            TouchSeen(one.boot_id, one.sequence)
            for one, before in zip(edges, befores, strict=True)
            if before and before.state is State.CLEAR and one.state is not State.CLEAR
        ]
        return [*commands, *touches]

    def segment(
        self, surface: str, stale_ms: float, model: ModelFile, batch: Batch, samples: list[Sample]
    ) -> list[Command]:
        """Return the commands for the late samples of a batch, in order; a state outlasts gaps up to `stale_ms`."""
        estimates = estimate(model, surface, batch, samples)
        gaps = [i + 1 for i, (one, other) in enumerate(pairwise(estimates)) if other.sequence != one.sequence + 1]
        commands: list[Command] = []
        for begin, end in pairwise([0, *gaps, len(estimates)]):
            commands += self._run(surface, stale_ms, model, batch.boot_id, estimates[begin:end])
        return commands

    def again(self, surface: str, stale_ms: float, model: ModelFile) -> list[Command]:
        """Return the commands for doubtful samples of which another service has recorded the sample before."""
        of_surface = [key for key in reversed(self._aside) if key[:2] == (surface, model.identity)]
        for key in of_surface[:_MAX_AGAIN]:
            boot_id, first = key[2:]
            _, past = self._before(surface, model, boot_id, first - 1)
            if len(past.memories) < len(memories_after(None)) and self._tried.get(key) != past:
                commands = self._run(surface, stale_ms, model, boot_id, self._take(key[:3], first))
                if key in self._aside:
                    self._tried[key] = past
                return commands
        return []

    def _run(
        self, surface: str, stale_ms: float, model: ModelFile, boot_id: str, run: list[Estimated]
    ) -> list[Command]:
        """Return the commands for a run of consecutive samples, with the doubtful ones beside it."""
        of_sender = surface, model.identity, boot_id
        while (first := self._aside_to.get((*of_sender, run[0].sequence - 1))) is not None:
            run = [*self._take(of_sender, first), *run]
        while more := self._take(of_sender, run[-1].sequence + 1):
            run = [*run, *more]
        before, past = self._before(surface, model, boot_id, run[0].sequence - 1)
        shown = self._edges.get((surface, boot_id, run[0].sequence))
        if before is State.UNEXPLAINED and shown and shown.state is not None:
            # It is on record. What it was shown from left out nothing but a stretch.
            past = Past(memories_after(shown.state)[:1])
        after = self._edges.get((surface, boot_id, run[-1].sequence + 1))
        # Only new samples open an event.
        segmenter = Segmenter(surface, model, boot_id, before, End.UNSEEN)
        follower = Follower(model, model.run, surface, stale_ms, past)
        found = segment_late_run(segmenter, follower.follow(run), after)
        for one in found:
            if isinstance(one, Doubtful):
                self._put_aside(of_sender, one)
        known = [one for one in found if not isinstance(one, Doubtful)]
        return self.commands_in(surface, stale_ms, known)

    def _take(self, of_sender: tuple[str, str, str], first: int) -> list[Estimated]:
        """Take the doubtful samples that begin with a number."""
        doubtful = self._aside.pop((*of_sender, first), None)
        if doubtful is None:
            return []
        self._tried.pop((*of_sender, first), None)
        del self._aside_to[*of_sender, doubtful.samples[-1].sequence]
        self._count -= len(doubtful.samples)
        return doubtful.samples

    def _put_aside(self, of_sender: tuple[str, str, str], doubtful: Doubtful) -> None:
        first, last = doubtful.samples[0].sequence, doubtful.samples[-1].sequence
        self._aside[*of_sender, first] = doubtful
        self._aside_to[*of_sender, last] = first
        self._count += len(doubtful.samples)
        while self._count > _MAX_ASIDE:
            (surface, model, boot_id, oldest), _ = next(iter(self._aside.items()))
            self._take((surface, model, boot_id), oldest)

    def _before(self, surface: str, model: ModelFile, boot_id: str, sequence: int) -> tuple[State | None, Past]:
        """Return the state after that sample, None if it is not known, and what it leaves to the next one."""
        edge, state = self._edges.get((surface, boot_id, sequence)), None
        # While the database is away, nothing more is known: the samples are decided again later.
        with suppress(EventsAwayError):
            edge = edge or self._store.edge(surface, boot_id, sequence)
            # An undecided sample may be part of an event, too.
            state = (edge.state if edge else None) or self._store.state_after(surface, boot_id, sequence)
        if edge and edge.model == model.identity:
            return state, edge.past
        return state, Past(memories_after(state))
