"""Groups consecutive decisions into segments of contacts and of unexplained stretches. Pure."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

from beamtouch_models.modelfile import State
from beamtouch_service.events.captures import Capture, Stretch
from beamtouch_service.events.segments import Begin, End, GrowingSegment, Kind, Segment
from beamtouch_service.surfaces.contact import Decision, Figures
from beamtouch_service.surfaces.touch import Seen

FLUSH_US = 1_000_000
"""An event that continues is written after this much of the sender's time, so that a crash costs no more."""


@dataclass(frozen=True)
class Finish:
    """The event whose last sample has number `last_sequence` ended; `LIFT` says that a clear sample follows."""

    boot_id: str
    last_sequence: int
    end: End
    lifted_us: int | None = None


@dataclass(frozen=True)
class TouchSeen:
    """The event whose first sample has number `first_sequence` began there: the sample before was clear."""

    boot_id: str
    first_sequence: int


@dataclass(frozen=True)
class Loss:
    """A write for this surface was lost: its open event ends as unseen."""


class Edge(NamedTuple):
    """A sample next to a gap: late samples that fill the gap are decided from its state."""

    boot_id: str
    sequence: int
    acquired_us: int
    state: State | None


Command = Segment | Capture | Finish | TouchSeen | Loss


class Segmenter:
    """Makes segments from the samples of one surface, sender and model, in the order of their sequence numbers."""

    def __init__(
        self, surface: str, model: str, boot_id: str, before: State | None = None, end: End = End.OPEN
    ) -> None:
        """Begin after a sample of state `before`; a segment whose end is not known yet gets `end`."""
        self.model, self.boot_id = model, boot_id
        self.last: Edge | None = None
        """The last sample."""
        self._surface = surface
        self._pending: GrowingSegment | None = None
        self._stretch = Stretch()
        self._end = end
        self._kind: Kind | None = None
        """Of the event that continues."""
        self._is_expired = False
        """The event ended as stale; it continues if the next sample arrives."""
        self._was_clear = before is State.CLEAR
        self._doubtful: list[Seen] = []
        """Samples before the next one that may belong to a stretch: odd ones, which no known sample comes before."""
        self._first_edge: Edge | None = None
        """The first sample of the run."""

    def add(self, seen: Seen) -> list[Command | Edge]:
        """Add the next sample."""
        sample, state = seen.estimated, seen.state
        first_of_run = not self._follows(sample.sequence)
        commands = self.end_run() if first_of_run else []
        doubtful, self._doubtful = [] if first_of_run else self._doubtful, []
        if state is State.CLEAR and seen.is_odd and not self._was_clear:
            state, self._doubtful = None, [*doubtful, seen]
        if state is State.CLEAR:
            commands += self._clear(sample.sequence, sample.acquired_unix_us, first_of_run=first_of_run)
        elif state or (seen.held is not State.CLEAR and self._kind):
            commands += self._begun_before(doubtful) if state is State.UNEXPLAINED else []
            commands += self._go_on(seen, unexplained=seen.held is State.UNEXPLAINED)
        else:
            commands += self.interrupt()
        self.last = Edge(self.boot_id, sample.sequence, sample.acquired_unix_us, state)
        self._first_edge = self.last if first_of_run else self._first_edge
        return [*commands, self.last] if first_of_run else commands

    def flush(self) -> list[Command | Edge]:
        """Return the segment of an event that continues, so that it can be written."""
        pending, self._pending = self._pending, None
        captured = self._stretch.take()
        commands: list[Command | Edge] = [pending.segment()] if pending else []
        return [*commands, Capture(self.model, self.boot_id, captured)] if captured else commands

    def expire(self) -> list[Command | Edge]:
        """End the event as stale: no sample has come for too long."""
        commands = self.flush()
        if self._kind and self.last:
            commands.append(Finish(self.boot_id, self.last.sequence, End.STALE))
            self._is_expired = True
        return commands

    def interrupt(self) -> list[Command | Edge]:
        """End the event as unseen: the next state is not known."""
        commands = self.flush()
        if self._kind and self.last:
            commands.append(Finish(self.boot_id, self.last.sequence, End.UNSEEN))
        self._stretch.end()
        self._kind, self._was_clear = None, False
        return commands

    def end_run(self) -> list[Command | Edge]:
        """End the run of consecutive samples: the next sample does not follow the last."""
        return [*self.interrupt(), self.last] if self.last else []

    def _follows(self, sequence: int) -> bool:
        return self.last is not None and sequence == self.last.sequence + 1

    def _clear(self, sequence: int, acquired_us: int, *, first_of_run: bool) -> list[Command | Edge]:
        commands = self.flush()
        if self._kind or first_of_run:
            commands.append(Finish(self.boot_id, sequence - 1, End.LIFT, acquired_us))
        self._stretch.end()
        self._kind, self._was_clear = None, True
        return commands

    def _begun_before(self, doubtful: list[Seen]) -> list[Command | Edge]:
        """Add the samples at the beginning of a stretch that shows only now."""
        commands = [command for seen in doubtful for command in self._go_on(seen, unexplained=True)]
        if doubtful and self._first_edge and self._first_edge.sequence == doubtful[0].estimated.sequence:
            return [*commands, self._first_edge._replace(state=State.UNEXPLAINED)]
        return commands

    def _go_on(self, seen: Seen, *, unexplained: bool) -> list[Command | Edge]:
        """Add a sample that is not clear. A contact outlasts an unexplained stretch, but not the other way round."""
        kind = self._kind if unexplained and self._kind else Kind.UNEXPLAINED if unexplained else Kind.CONTACT
        is_new, commands = kind is not self._kind, list[Command | Edge]()
        if is_new:
            commands = self.flush()
        if not unexplained:
            self._stretch.end()
        elif seen.why:
            self._stretch.add(seen.why)
        sequence, acquired_us = seen.estimated.sequence, seen.estimated.acquired_unix_us
        if self._pending is None:
            self._pending = GrowingSegment(self._first(kind, sequence, acquired_us))
        degraded = bool(seen.estimated.bad) or seen.state is None
        self._pending.add(
            sequence,
            acquired_us,
            _figures(seen),
            unexplained=unexplained,
            degraded=degraded,
            readings=seen.estimated.readings or 1,
        )
        # Write an event at once when it begins or resumes, then at intervals.
        due = is_new or self._is_expired or self._pending.duration_us >= FLUSH_US
        self._kind, self._was_clear, self._is_expired = kind, False, False
        return [*commands, *self.flush()] if due else commands

    def _first(self, kind: Kind, sequence: int, acquired_us: int) -> Segment:
        begin = Begin.UNSEEN
        if self._was_clear:
            begin = Begin.TOUCH if kind is Kind.CONTACT else Begin.CLEAR
        key = self._surface, self.model, self.boot_id
        return Segment(*key, sequence, sequence, acquired_us, acquired_us, kind=kind, begin=begin, end=self._end)


def _figures(seen: Seen) -> Figures | None:
    """Return the figures that count in an event; None if the sample is odd or undecided."""
    if seen.state is not State.CONTACT or seen.is_odd or not isinstance(seen.outcome, Decision):
        return None
    return seen.outcome.figures


def segment_late_run(segmenter: Segmenter, run: Iterable[Seen], after: Edge | None) -> list[Command | Edge]:
    """Return the commands for a run of consecutive late samples; `after` is the sample that follows, if known."""
    commands = [command for seen in run for command in segmenter.add(seen)]
    last = segmenter.last
    if last is None:
        return commands
    commands += segmenter.end_run()
    if last.state is State.CLEAR:
        commands.append(TouchSeen(segmenter.boot_id, last.sequence + 1))
    elif after and after.state is State.CLEAR:
        commands.append(Finish(segmenter.boot_id, last.sequence, End.LIFT, after.acquired_us))
    return commands
