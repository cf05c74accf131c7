"""Groups consecutive decisions into contact segments. Pure."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

from beamtouch_models.modelfile import State
from beamtouch_service.events.segments import Begin, End, GrowingSegment, Segment
from beamtouch_service.surfaces.contact import Decision
from beamtouch_service.surfaces.touch import Seen

FLUSH_US = 1_000_000
"""A contact that continues is written after this much of the sender's time, so that a crash costs no more."""


@dataclass(frozen=True)
class Finish:
    """The contact whose last sample has number `last_sequence` ended."""

    boot_id: str
    last_sequence: int
    end: End
    lifted_us: int | None = None


@dataclass(frozen=True)
class TouchSeen:
    """The contact whose first sample has number `first_sequence` began there: the sample before was clear."""

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


Command = Segment | Finish | TouchSeen | Loss


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
        self._end = end
        self._in_contact = False
        self._is_expired = False
        """The contact ended as stale; it continues if the next sample arrives."""
        self._was_clear = before is State.CLEAR

    def add(self, seen: Seen) -> list[Command | Edge]:
        """Add the next sample."""
        sample = seen.estimated
        first_of_run = not self._follows(sample.sequence)
        commands = self.end_run() if first_of_run else []
        if seen.state is State.CLEAR:
            commands += self._clear(sample.sequence, sample.acquired_unix_us, first_of_run=first_of_run)
        elif seen.state is State.CONTACT or (seen.held is not State.CLEAR and self._in_contact):
            commands += self._contact(seen)
        else:
            commands += self.interrupt()
        self.last = Edge(self.boot_id, sample.sequence, sample.acquired_unix_us, seen.state)
        return [*commands, self.last] if first_of_run else commands

    def flush(self) -> list[Command | Edge]:
        """Return the segment of a contact that continues, so that it can be written."""
        pending, self._pending = self._pending, None
        return [pending.segment()] if pending else []

    def expire(self) -> list[Command | Edge]:
        """End the contact as stale: no sample has come for too long."""
        commands = self.flush()
        if self._in_contact and self.last:
            commands.append(Finish(self.boot_id, self.last.sequence, End.STALE))
            self._is_expired = True
        return commands

    def interrupt(self) -> list[Command | Edge]:
        """End the contact as unseen: the next state is not known."""
        commands = self.flush()
        if self._in_contact and self.last:
            commands.append(Finish(self.boot_id, self.last.sequence, End.UNSEEN))
        self._in_contact = self._was_clear = False
        return commands

    def end_run(self) -> list[Command | Edge]:
        """End the run of consecutive samples: the next sample does not follow the last."""
        return [*self.interrupt(), self.last] if self.last else []

    def _follows(self, sequence: int) -> bool:
        return self.last is not None and sequence == self.last.sequence + 1

    def _clear(self, sequence: int, acquired_us: int, *, first_of_run: bool) -> list[Command | Edge]:
        commands = self.flush()
        if self._in_contact or first_of_run:
            commands.append(Finish(self.boot_id, sequence - 1, End.LIFT, acquired_us))
        self._in_contact, self._was_clear = False, True
        return commands

    def _contact(self, seen: Seen) -> list[Command | Edge]:
        sequence, acquired_us = seen.estimated.sequence, seen.estimated.acquired_unix_us
        figures = seen.outcome.figures if seen.state is State.CONTACT and isinstance(seen.outcome, Decision) else None
        is_new, degraded = not self._in_contact, bool(seen.estimated.bad) or figures is None
        if self._pending is None:
            begin = Begin.TOUCH if is_new and self._was_clear else Begin.UNSEEN
            key = self._surface, self.model, self.boot_id
            self._pending = GrowingSegment(
                Segment(*key, sequence, sequence, acquired_us, acquired_us, begin=begin, end=self._end)
            )
        self._pending.add(sequence, acquired_us, figures, degraded=degraded)
        # Write a contact at once when it begins or resumes, then at intervals.
        due = is_new or self._is_expired or self._pending.duration_us >= FLUSH_US
        self._in_contact, self._was_clear, self._is_expired = True, False, False
        return self.flush() if due else []


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
