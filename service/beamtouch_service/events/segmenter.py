"""Groups consecutive decisions into segments of contacts and of unexplained stretches. Pure."""

from collections.abc import Iterable

from beamtouch_models.modelfile import ModelFile, State
from beamtouch_service.events.best_samples import BestSamples
from beamtouch_service.events.captures import Capture
from beamtouch_service.events.findings import Command, Doubtful, Edge, Finish, Found, TouchSeen
from beamtouch_service.events.growing_segment import GrowingSegment
from beamtouch_service.events.segments import Begin, End, EventKind, Segment
from beamtouch_service.surfaces.contact import Decision, Figures
from beamtouch_service.surfaces.contradiction import Contradiction
from beamtouch_service.surfaces.follower import Seen

FLUSH_US = 1_000_000
"""An event that continues is written after this much of the sender's time, so that a crash costs no more."""


MAX_DOUBTFUL = 1000
"""Samples of a run that are put aside; a beam may ring for seconds. After more, a state that is held counts."""


class Segmenter:
    """Makes segments from the samples of one surface, sender and model, in the order of their sequence numbers."""

    def __init__(
        self, surface: str, model: ModelFile, boot_id: str, before: State | None = None, end: End = End.OPEN
    ) -> None:
        """Begin after a sample of state `before`; a segment whose end is not known yet gets `end`."""
        self.model, self.boot_id, self._file = model.identity, boot_id, model
        self.last: Edge | None = None
        """The last sample."""
        self._surface = surface
        self._pending: GrowingSegment | None = None
        self._captured: list[Contradiction] = []
        """Samples that have yet to be written."""
        self._best = BestSamples(model)
        self._end = end
        self._kind: EventKind | None = None
        """Of the event that continues."""
        self._is_expired = False
        """The event ended as stale; it continues if the next sample arrives."""
        self._was_clear = before is State.CLEAR
        self._goes_on = before in (State.CONTACT, State.UNEXPLAINED)
        """Whether an event lasts up to the first sample."""
        self._doubtful: list[Seen] | None = []
        """The newest samples of the run, while those before the run matter."""
        self._room = MAX_DOUBTFUL
        """This many more of them can be put aside."""

    def add(self, seen: Seen) -> list[Found]:
        """Add the next sample."""
        is_first = self.last is None or seen.estimated.sequence != self.last.sequence + 1
        commands = self.end_run() if is_first else []
        if seen.is_sure:
            self._room = MAX_DOUBTFUL
        elif self._doubtful is None and self._room and self.last:
            # A state was held for too long over undecided samples.
            self._doubtful = []
            commands.append(self.last)
        is_end_of_doubt = self._doubtful is not None and (seen.is_sure or not self._room)
        if is_end_of_doubt:
            commands += self._settle(unexplained=seen.state is State.UNEXPLAINED)
            self._doubtful = None
        elif self._doubtful is not None:
            # Late samples may go on from the first sample that is known.
            if seen.shown and self._doubtful and not self._doubtful[-1].shown:
                commands += self._put_aside()
            self._doubtful.append(seen)
            self._room -= 1
        counts = seen.shown or (self._doubtful is None and seen.held is not State.CLEAR)
        if not counts:
            commands += self.interrupt()
        is_edge = is_first or is_end_of_doubt or (counts and self.last is not None and self.last.state is None)
        self.last = self._edge(seen, seen.state if counts else None)
        if counts:
            commands += self._record(seen)
        return [*commands, self.last] if is_edge else commands

    def _record(self, seen: Seen) -> list[Command]:
        """Add a sample whose state counts."""
        sample, state = seen.estimated, seen.state
        if state is State.CLEAR:
            commands = self._clear(sample.sequence, sample.acquired_unix_us)
            self._best.clear(seen)
            return commands
        if state or (seen.held is not State.CLEAR and (self._kind or self._goes_on)):
            return self._go_on(seen, unexplained=seen.held is State.UNEXPLAINED)
        return self.interrupt()

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
        self._best.lift()
        self._kind, self._was_clear, self._goes_on = None, False, False
        return commands

    def end_run(self) -> list[Found]:
        """End the run of consecutive samples: the next sample does not follow the last."""
        if self.last is None:
            return []
        commands: list[Found] = [*self.interrupt(), *self._put_aside(), self.last]
        self._doubtful, self._room = [], MAX_DOUBTFUL
        return commands

    def _settle(self, *, unexplained: bool) -> list[Found]:
        """Say what becomes of the doubtful samples: the beginning of a stretch, or nothing that is known so far."""
        doubtful = self._doubtful
        if not doubtful or not unexplained or any(seen.shown for seen in doubtful):
            return self._put_aside()
        commands: list[Found] = [one for seen in doubtful for one in self._go_on(seen, unexplained=True)]
        return [*commands, self._edge(doubtful[0], State.UNEXPLAINED)]

    def _put_aside(self) -> list[Found]:
        doubtful, self._doubtful = self._doubtful, []
        return [Doubtful(self.boot_id, self._file, [seen.estimated.alone() for seen in doubtful])] if doubtful else []

    def _edge(self, seen: Seen, state: State | None) -> Edge:
        sample = seen.estimated
        return Edge(self.boot_id, self.model, sample.sequence, sample.acquired_unix_us, state, seen.past)

    def _clear(self, sequence: int, acquired_us: int) -> list[Command]:
        commands = self.flush()
        if self._kind:
            self._best.lift()
        if not self._was_clear:
            commands.append(Finish(self.boot_id, sequence - 1, End.LIFT, acquired_us))
        self._kind, self._was_clear, self._goes_on = None, True, False
        return commands

    def _go_on(self, seen: Seen, *, unexplained: bool) -> list[Command]:
        """Add a sample that is not clear. A contact outlasts an unexplained stretch, but not the other way round."""
        kind = self._kind if unexplained and self._kind else EventKind.UNEXPLAINED if unexplained else EventKind.CONTACT
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

    def _first(self, kind: EventKind, sequence: int, acquired_us: int) -> Segment:
        begin = Begin.UNSEEN
        if self._was_clear:
            begin = Begin.TOUCH if kind is EventKind.CONTACT else Begin.CLEAR
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
