"""The samples of one boot, once and in order, as events. Pure but for the run of the model.

What a sample adds depends on the samples before it and on the model alone. So a course that goes on from its memory,
in another process, makes the same events.
"""

from typing import Any

import numpy as np

from beamtouch_models.modelfile import Memory, ModelFile, State, Suspects
from beamtouch_service.events.best import BestSamples, Rest
from beamtouch_service.events.contradiction import contradiction
from beamtouch_service.events.event import Begin, End, Event, EventKind, OpenEvent, Taken
from beamtouch_service.surfaces.estimates import Estimated
from beamtouch_service.surfaces.judge import NEUTRAL, Judge, Judged, Past, evidence_of

MAX_CAPTURED = 5
"""Unexplained samples that an event keeps, channel by channel: what contradicts what shows in the first ones."""


class Course:
    """Decides on the samples of one boot, and groups them into events."""

    def __init__(self, surface: str, boot_id: str, model: ModelFile, hold_ms: float) -> None:
        """Begin with nothing known of the samples before."""
        self.model = model
        self._key = surface, model.identity, boot_id
        self._hold_ms = hold_ms
        self.event: OpenEvent | None = None
        """The event that continues."""
        self.changed: list[OpenEvent] = []
        """Events that began, went on or ended since the last call of `take_changed`, in order."""
        self._suspects = Suspects(model.metadata, model.run)
        self._begin(NEUTRAL, Rest(), was_clear=False)

    def _begin(self, past: Past, rest: Rest, *, was_clear: bool) -> None:
        self._judge = Judge(self.model, self._key[0], self._hold_ms, past)
        self._best = BestSamples(self.model, rest)
        self._was_clear = was_clear

    def go_on(self, memory: dict[str, Any], event: Event | None, number: int | None) -> None:
        """Go on from a memory, with the event that it left open; raises ValueError if it cannot be read."""
        try:
            past = Past(
                tuple(_memory(kept) for kept in memory["memories"]),
                bool(memory["is_known"]),
                memory["decided_us"],
                bool(memory["is_held"]),
            )
            means = memory["means"]
            open_event = OpenEvent(event, number, means) if event and means else None
            self._begin(past, Rest.of(memory["rest"]), was_clear=bool(memory["was_clear"]))
        except (KeyError, TypeError, ValueError) as error:
            message = f"the memory of a decision cannot be read ({error!r})"
            raise ValueError(message) from None
        self.event = open_event

    def memory(self) -> dict[str, Any]:
        """Return what it needs beside the open event to go on, as JSON."""
        past = self._judge.past
        return {
            "memories": [list(one) for one in past.memories],
            "is_known": past.is_known,
            "decided_us": past.decided_us,
            "is_held": past.is_held,
            "was_clear": self._was_clear,
            "rest": self._best.rest.kept(),
            "means": self.event.means if self.event else None,
        }

    def take_changed(self) -> list[OpenEvent]:
        """Return the events that changed since the last call."""
        changed, self.changed = self.changed, []
        return changed

    def lose(self) -> None:
        """End the open event: the next samples are lost, or decided by another model. Nothing is known any more."""
        self._interrupt()
        self._begin(NEUTRAL, Rest(), was_clear=False)

    def add(self, sample: Estimated) -> None:
        """Add the next sample."""
        judged = self._judge.judge(sample)
        if judged.state is State.CLEAR and judged.shown:
            self._clear(judged)
        elif judged.held is not State.CLEAR and (self.event or (judged.state and judged.shown)):
            self._go_on(judged)
        else:
            self._interrupt()

    def _clear(self, judged: Judged) -> None:
        if self.event:
            self.event.lift(judged.estimated.acquired_unix_us)
            self._end()
            self._best.lift()
        self._was_clear = True
        self._best.clear(judged)

    def _interrupt(self) -> None:
        """End the open event: the state of the next sample is not known."""
        if self.event:
            self.event.finish(End.UNSEEN)
            self._end()
        self._best.lift()
        self._was_clear = False

    def _end(self) -> None:
        event, self.event = self.event, None
        if event and event not in self.changed:
            self.changed.append(event)

    def _go_on(self, judged: Judged) -> None:
        """Add a sample that is not clear. A contact outlasts an unexplained stretch, but not the other way round."""
        unexplained = judged.held is State.UNEXPLAINED
        event, begin = self.event, Begin.UNSEEN
        if event and event.kind is EventKind.UNEXPLAINED and not unexplained:
            event.finish(End.CONTACT)
            self._end()
            event, begin = None, Begin.UNEXPLAINED
        if event is None:
            event = self.event = self._first(judged.estimated, begin, unexplained=unexplained)
        sample = judged.estimated
        figures = None if judged.state is None or judged.is_odd or unexplained else judged.figures
        degraded = bool(sample.bad) or judged.state is None
        place = sample.sequence, sample.acquired_unix_us, sample.readings or 1
        event.add(Taken(*place, figures, unexplained, degraded, judged.is_unsteady))
        event.best = self._best.best(event.best, judged)
        if judged.state is State.UNEXPLAINED and len(event.capture) < MAX_CAPTURED:
            event.capture.append(self._captured(judged))
        if event not in self.changed:
            self.changed.append(event)
        self._was_clear = False

    def _first(self, sample: Estimated, begin: Begin, *, unexplained: bool) -> OpenEvent:
        kind = EventKind.UNEXPLAINED if unexplained else EventKind.CONTACT
        if self._was_clear:
            begin = Begin.CLEAR if unexplained else Begin.TOUCH
        sequence, at_us = sample.sequence, sample.acquired_unix_us
        return OpenEvent(Event(*self._key, sequence, sequence, at_us, at_us, kind, begin))

    def _captured(self, judged: Judged) -> dict[str, Any]:
        sample = judged.estimated
        (without,) = self._suspects.leave_out([sample.weighed.part(np.array([sample.row]))])
        return contradiction(self.model.metadata, sample, evidence_of(judged), without).model_dump(mode="json")


def _memory(kept: list[Any]) -> Memory:
    state, armed, still, changing, run, seen_mm = kept
    return Memory(State(state), armed, still, changing, run, None if seen_mm is None else tuple(seen_mm))
