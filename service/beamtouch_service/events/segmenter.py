"""Groups consecutive decisions into segments of contacts and of unexplained stretches. Pure."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

from beamtouch_models.modelfile import ModelFile, State
from beamtouch_service.events.best_samples import BestSamples
from beamtouch_service.events.captures import Capture
from beamtouch_service.events.segments import Begin, End, GrowingSegment, Kind, Segment
from beamtouch_service.surfaces.contact import Decision, Figures
from beamtouch_service.surfaces.contradiction import Contradiction
from beamtouch_service.surfaces.estimates import Estimated
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


class Doubtful(NamedTuple):
    """Samples at the beginning of a run that are on no record: their states depend on the sample before them."""

    boot_id: str
    samples: list[Estimated]


MAX_DOUBTFUL, MAX_UNDECIDED = 10, 100
"""Samples of a run that may be doubtful: with a state, and without one. After more, the state that is held counts."""
ODD_IN_A_ROW = 3
"""Odd samples in a row that are unexplained, whatever comes before them."""

Command = Segment | Capture | Finish | TouchSeen | Loss | Edge
Found = Command | Doubtful


class Segmenter:
    """Makes segments from the samples of one surface, sender and model, in the order of their sequence numbers."""

    def __init__(
        self, surface: str, model: ModelFile, boot_id: str, before: State | None = None, end: End = End.OPEN
    ) -> None:
        """Begin after a sample of state `before`; a segment whose end is not known yet gets `end`."""
        self.model, self.boot_id = model.identity, boot_id
        self.last: Edge | None = None
        """The last sample."""
        self._surface = surface
        self._pending: GrowingSegment | None = None
        self._captured: list[Contradiction] = []
        """Samples that have yet to be written."""
        self._best = BestSamples(model)
        self._end = end
        self._kind: Kind | None = None
        """Of the event that continues."""
        self._is_expired = False
        """The event ended as stale; it continues if the next sample arrives."""
        self._was_clear = before is State.CLEAR
        self._goes_on = before in (State.CONTACT, State.UNEXPLAINED)
        """Whether an event lasts up to the first sample."""
        self._is_sure = before is not None
        """Whether the state is known: from before the run, or from a sample of it that shows it by itself."""
        self._doubtful: list[Seen] = []
        """The samples of the run so far, while the state is not known."""

    def add(self, seen: Seen) -> list[Found]:
        """Add the next sample."""
        sample, state = seen.estimated, seen.state
        first_known = not self.follows(sample.sequence)
        commands = self.end_run() if first_known else []
        self.last = Edge(self.boot_id, sample.sequence, sample.acquired_unix_us, state)
        if not self._is_sure:
            if self._is_doubtful(seen):
                self._doubtful.append(seen)
                self.last = self.last._replace(state=None)
                return commands
            first_known = True
            commands += self._settle(unexplained=state is State.UNEXPLAINED)
        if state is State.CLEAR:
            commands += self._clear(sample.sequence, sample.acquired_unix_us, first_known=first_known)
            self._best.clear(seen)
        elif state or (seen.held is not State.CLEAR and (self._kind or self._goes_on)):
            commands += self._go_on(seen, unexplained=seen.held is State.UNEXPLAINED)
        else:
            commands += self.interrupt()
        return [*commands, self.last] if first_known else commands

    def flush(self) -> list[Command]:
        """Return the segment of an event that continues, so that it can be written."""
        pending, self._pending = self._pending, None
        captured, self._captured = self._captured, []
        commands: list[Command] = [pending.segment()] if pending else []
        return [*commands, Capture(self.model, self.boot_id, captured)] if captured else commands

    def expire(self) -> list[Command]:
        """End the event as stale: no sample has come for too long."""
        commands = self.flush()
        if self._kind and self.last:
            commands.append(Finish(self.boot_id, self.last.sequence, End.STALE))
            self._is_expired = True
        return commands

    def interrupt(self) -> list[Command]:
        """End the event as unseen: the next state is not known."""
        commands = self.flush()
        if self._kind and self.last:
            commands.append(Finish(self.boot_id, self.last.sequence, End.UNSEEN))
        self._kind, self._was_clear, self._goes_on = None, False, False
        return commands

    def end_run(self) -> list[Found]:
        """End the run of consecutive samples: the next sample does not follow the last."""
        if self.last is None:
            return []
        commands: list[Found] = [*self.interrupt()]
        commands += self._put_aside() if self._doubtful else [self.last]
        self._is_sure = False
        return commands

    def _is_doubtful(self, seen: Seen) -> bool:
        """Return whether the state of a sample at the beginning of a run depends on what comes before the run."""
        undecided = sum(one.state is None for one in self._doubtful)
        if len(self._doubtful) - undecided >= MAX_DOUBTFUL or undecided >= MAX_UNDECIDED:
            return False
        if seen.is_odd:
            row = [*self._doubtful, seen][-ODD_IN_A_ROW:]
            return len(row) < ODD_IN_A_ROW or not all(one.is_odd for one in row)
        return seen.state is None or not seen.shown

    def _settle(self, *, unexplained: bool) -> list[Found]:
        """Say what becomes of the doubtful samples: the beginning of a stretch, or nothing that is known so far."""
        self._is_sure = True
        if not unexplained:
            return self._put_aside()
        doubtful, self._doubtful = self._doubtful, []
        commands: list[Found] = [one for seen in doubtful for one in self._go_on(seen, unexplained=True)]
        if doubtful:
            first = doubtful[0].estimated
            commands.append(Edge(self.boot_id, first.sequence, first.acquired_unix_us, State.UNEXPLAINED))
        return commands

    def _put_aside(self) -> list[Found]:
        doubtful, self._doubtful = self._doubtful, []
        return [Doubtful(self.boot_id, [seen.estimated.alone() for seen in doubtful])] if doubtful else []

    def follows(self, sequence: int) -> bool:
        """Return whether the sample of this number comes directly after the last one."""
        return self.last is not None and sequence == self.last.sequence + 1

    def _clear(self, sequence: int, acquired_us: int, *, first_known: bool) -> list[Command]:
        commands = self.flush()
        if self._kind:
            self._best.lift()
        if self._kind or first_known:
            commands.append(Finish(self.boot_id, sequence - 1, End.LIFT, acquired_us))
        self._kind, self._was_clear, self._goes_on = None, True, False
        return commands

    def _go_on(self, seen: Seen, *, unexplained: bool) -> list[Command]:
        """Add a sample that is not clear. A contact outlasts an unexplained stretch, but not the other way round."""
        kind = self._kind if unexplained and self._kind else Kind.UNEXPLAINED if unexplained else Kind.CONTACT
        is_new, commands = kind is not self._kind, list[Command]()
        if is_new:
            commands = self.flush()
        if seen.why:
            self._captured.append(seen.why)
        sequence, acquired_us = seen.estimated.sequence, seen.estimated.acquired_unix_us
        if self._pending is None:
            self._pending = GrowingSegment(self._first(kind, sequence, acquired_us))
        degraded = bool(seen.estimated.bad) or seen.state is None
        figures = None if seen.is_odd or unexplained else _figures(seen)
        self._pending.add(
            sequence,
            acquired_us,
            figures,
            unexplained=unexplained,
            degraded=degraded,
            unsteady=seen.is_unsteady,
            readings=seen.estimated.readings or 1,
        )
        self._pending.best = self._best.best(self._pending.best, seen)
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
    """Return the figures of a sample; None if it is undecided."""
    return seen.outcome.figures if isinstance(seen.outcome, Decision) else None


def segment_late_run(segmenter: Segmenter, run: Iterable[Seen], after: Edge | None) -> list[Found]:
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
