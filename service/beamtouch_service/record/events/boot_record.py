"""The samples of one boot, once and in order, as events. Pure but for the run of the model.

What a sample adds depends on the samples before it and on the model alone. So a boot that goes on from its memory, in
another process, makes the same events.
"""

import logging
from math import isfinite
from typing import Any

from beamtouch_models.runtime import ModelFile, State, Suspects
from beamtouch_service.record.events.best import Best, BestSamples, DisjointMean
from beamtouch_service.record.events.changes import BootChange, Cursor
from beamtouch_service.record.events.event import Begin, ChannelDoubt, Contradiction, End, Event, EventKind, OpenEvent
from beamtouch_service.record.events.load import begin_us, sighting_of
from beamtouch_service.sections import SurfaceSection
from beamtouch_service.surfaces.contact import rfc3339
from beamtouch_service.surfaces.estimate import Estimate
from beamtouch_service.surfaces.follower import NEUTRAL, Decision, Judge, Past

MAX_WAITING = 20_000
"""Samples of a boot that may wait to become durable. The sender keeps the others."""
MAX_CAPTURED = 5
"""Unexplained samples that an event keeps, channel by channel: what contradicts what shows in the first ones."""
_DIGITS = 6
"""Significant digits of a capture; the answers of a graph have seven."""

_log = logging.getLogger(__name__)


class BootRecord:
    """One boot, up to the next sample that the record expects."""

    def __init__(self, surface: str, section: SurfaceSection, boot_id: str, model: ModelFile, durable: int) -> None:
        """Begin after the sample with the number `durable`, with nothing known of the samples before."""
        self.durable = durable
        """Number of the last sample that is durable."""
        self.expected = durable + 1
        """Number of the sample that comes next."""
        self.event: OpenEvent | None = None
        """The event that continues."""
        self._version = 0
        """How often its cursor was written."""
        self._changed: list[OpenEvent] = []
        """Events that began, went on or ended since the last change that was made durable, in order."""
        self._ended: list[OpenEvent] = []
        """Events that ended since the last call of `take_best`."""
        self._surface, self._section, self._boot_id = surface, section, boot_id
        self._begin(model)

    def _begin(self, model: ModelFile, past: Past = NEUTRAL, rest: DisjointMean | None = None) -> None:
        self.model = model
        self._suspects = Suspects(model.metadata, model.run)
        self._judge = Judge(model, self._surface, self._section, past)
        self._best = BestSamples(model, rest or DisjointMean())
        self._was_clear = False

    def go_on(self, cursor: Cursor) -> None:
        """Go on from what is on record. Another model ends the open event, and so does a memory that is not read."""
        self._version = cursor.version
        number, event = cursor.event or (None, None)
        try:
            if cursor.model != self.model.identity:
                raise ValueError(f"another model decided it ({cursor.model})")
            self._remember(cursor.memory)
            self.event = OpenEvent(event, number, cursor.memory["load"]) if event else None
        except (KeyError, TypeError, ValueError) as error:
            _log.info("surface %s: an event of boot %s cannot go on: %s", self._surface, self._boot_id, error)
            self.event = OpenEvent(event, number) if event else None
            self.lose()

    def _remember(self, memory: dict[str, Any]) -> None:
        self._begin(self.model, Past.read(memory), DisjointMean.read(memory["rest"]))
        self._was_clear = memory["was_clear"]

    def _memory(self) -> dict[str, Any]:
        """Return what it needs beside the open event to go on, as JSON."""
        return self._judge.past._asdict() | {
            "was_clear": self._was_clear,
            "rest": self._best.rest.to_json(),
            "load": self.event.load.memory if self.event else None,
        }

    @property
    def is_dirty(self) -> bool:
        """True if something is not durable."""
        return self.expected > self.durable + 1 or bool(self._changed)

    @property
    def has_ended(self) -> bool:
        """True if an event ended that is not durable as it is now."""
        return any(event.event.end is not End.OPEN for event in self._changed)

    @property
    def has_room(self) -> bool:
        """True if it can take another sample."""
        return self.expected - self.durable <= MAX_WAITING

    def change(self) -> BootChange:
        """Return what is not durable."""
        changed, self._changed = self._changed, []
        return BootChange(
            self._boot_id,
            self._version,
            self.expected - 1,
            self.model.identity,
            self._memory(),
            [(event, event.number, event.row()) for event in changed],
            self.event,
        )

    def take_best(self) -> list[Best]:
        """Return the best samples of the events that ended under the model in use since the last call."""
        ended, self._ended = self._ended, []
        return [event.best for event in ended if event.best and event.event.model == self.model.identity]

    def take_back(self, change: BootChange) -> None:
        """Keep a change that could not be made durable."""
        events = [event for event, _, _ in change.events]
        self._changed = [*events, *(event for event in self._changed if event not in events)]

    def note_durable(self, change: BootChange, numbers: dict[OpenEvent, int]) -> None:
        """Note that a change is durable; `numbers` are the ids of new events."""
        self.durable, self._version = change.durable, change.version + 1
        for event, _, _ in change.events:
            event.number = numbers.get(event, event.number)

    def pass_to(self, number: int) -> int:
        """Note that the samples before this number are lost; return how many they are."""
        lost = max(0, number - self.expected)
        if lost:
            self.lose()
            self.expected = number
        return lost

    def adopt(self, model: ModelFile) -> None:
        """Decide with this model from now on. Another one ends the open event.

        One of the same beam and channels goes on from the state that is there, as the live answer does.
        """
        if self.model is not model:
            self._interrupt()
            is_alike = (self.model.metadata.beam, self.model.channels) == (model.metadata.beam, model.channels)
            self._begin(model, self._judge.past if is_alike else NEUTRAL)

    def lose(self) -> None:
        """End the open event: what came after it is lost, or was not seen. Nothing is known any more."""
        self._interrupt()
        self._begin(self.model)

    def add(self, estimate: Estimate) -> None:
        """Add the sample that is expected."""
        self.expected = estimate.sample.sequence + 1
        at_us = estimate.sample.acquired_unix_us
        if self._judge.is_over(at_us):
            self.lose()
        decision = self._judge.judge(estimate, at_us)
        if decision.state is State.CLEAR and decision.is_certain:
            self._lift(decision)
        elif decision.held is not State.CLEAR and (self.event or (decision.state and decision.is_certain)):
            self._extend(decision)
        else:
            self._interrupt()

    def _lift(self, decision: Decision) -> None:
        if self.event:
            at_us = decision.estimate.sample.acquired_unix_us
            self.event.lift(at_us, begin_us(decision, self._best.reading_us))
            self._end()
        self._was_clear = True
        self._best.add_rest(decision)

    def _interrupt(self) -> None:
        """End the open event: the state of the next sample is not known."""
        if self.event:
            self.event.finish(End.UNSEEN)
        self._end()
        self._was_clear = False

    def _end(self) -> None:
        event, self.event = self.event, None
        if event:
            self._ended.append(event)
            if event not in self._changed:
                self._changed.append(event)
        self._best.rest = DisjointMean()

    def _extend(self, decision: Decision) -> None:
        """Add a sample that is not clear. A contact outlasts an unexplained stretch, but not the other way round."""
        is_stretch, begin = decision.held is State.UNEXPLAINED, Begin.UNSEEN
        if self.event and self.event.event.kind is EventKind.UNEXPLAINED and not is_stretch:
            self.event.finish(End.CONTACT)
            rest = self._best.rest
            self._end()
            self._best.rest, begin = rest, Begin.UNEXPLAINED
        event = self.event = self.event or OpenEvent(self._first(decision, begin, is_stretch=is_stretch))
        event.add(decision, sighting_of(decision, self.model.metadata.thresholds.touch, self._best.reading_us))
        event.best = self._best.choose(event.best, decision)
        if decision.state is State.UNEXPLAINED and len(event.event.capture) < MAX_CAPTURED:
            event.event.capture.append(self._capture(decision).model_dump())
        if event not in self._changed:
            self._changed.append(event)
        self._was_clear = False

    def _first(self, decision: Decision, begin: Begin, *, is_stretch: bool) -> Event:
        if self._was_clear:
            begin = Begin.CLEAR if is_stretch else Begin.TOUCH
        kind, sample = EventKind.UNEXPLAINED if is_stretch else EventKind.CONTACT, decision.estimate.sample
        number, at_us = sample.sequence, sample.acquired_unix_us
        place: dict[str, list[float | None] | None] = dict.fromkeys(self.model.metadata.axes)
        head = self._surface, self.model.identity, self._boot_id, number, number, at_us, at_us, kind, begin
        return Event(*head, place=place)

    def _capture(self, decision: Decision) -> Contradiction:
        estimate, evidence = decision.estimate, decision.evidence
        (without,) = self._suspects.leave_out(estimate.weighed)
        channels = []
        for name, deflection_mm in zip(self.model.channels, estimate.together.deflection_mm[estimate.row], strict=True):
            left = without.get(name)
            if name not in estimate.bad:
                doubt = (_short(left.misfit), left.explained) if left else (None, False)
                channels.append(
                    ChannelDoubt(
                        name=name,
                        deflection_mm=float(f"{deflection_mm:.{_DIGITS}g}"),
                        misfit_without=doubt[0],
                        explained_without=doubt[1],
                    )
                )
        return Contradiction(
            sequence=estimate.sample.sequence,
            sampled_at=rfc3339(estimate.sample.acquired_unix_us),
            misfit=_short(evidence.misfit),
            rest_misfit=_short(evidence.rest_misfit),
            channels=channels,
        )


def _short(value: float) -> float | None:
    return float(f"{value:.{_DIGITS}g}") if isfinite(value) else None
