"""The boots of the senders of one surface, and how far the record of each is. Pure but for the run of the model."""

import logging
from dataclasses import dataclass, field

from beamtouch_models.modelfile import ModelFile
from beamtouch_service.events.course import Course
from beamtouch_service.events.event import End, OpenEvent
from beamtouch_service.events.store import Change, Cursor
from beamtouch_service.samples import MAX_EARLIER, Batch
from beamtouch_service.surfaces.estimates import Estimated

MAX_WAITING = 20_000
"""Samples of a boot that may wait to become durable. The sender keeps the others."""

_log = logging.getLogger("beamtouch.service.events")


@dataclass
class Boot:
    """The samples of one boot, up to the next one that the record expects."""

    course: Course
    durable: int
    """Number of the last sample that is durable."""
    version: int = 0
    """How often its cursor was written."""
    expected: int = field(init=False)
    """Number of the sample that comes next."""

    def __post_init__(self) -> None:
        self.expected = self.durable + 1

    @property
    def is_dirty(self) -> bool:
        """Whether something is not durable."""
        return self.expected > self.durable + 1 or bool(self.course.changed)

    @property
    def has_room(self) -> bool:
        """Whether it can take another sample."""
        return self.expected - self.durable <= MAX_WAITING

    def pass_to(self, number: int) -> int:
        """Note that the samples before this number are lost; return how many they are."""
        lost = max(0, number - self.expected)
        if lost:
            self.course.lose()
            self.expected = number
        return lost

    def add(self, sample: Estimated) -> None:
        """Add the sample that is expected."""
        self.course.add(sample)
        self.expected = sample.sequence + 1

    def change(self, surface: str, boot_id: str) -> Change:
        """Return what is not durable."""
        course = self.course
        events = [(event, event.number, event.row()) for event in course.take_changed()]
        return Change(
            surface,
            boot_id,
            self.version,
            self.expected - 1,
            course.model.identity,
            course.memory(),
            events,
            course.event,
        )

    def take_back(self, change: Change) -> None:
        """Keep a change that could not be made durable."""
        events = [event for event, _, _ in change.events]
        self.course.changed = [*events, *(event for event in self.course.changed if event not in events)]

    def made(self, change: Change, numbers: dict[OpenEvent, int]) -> None:
        """Note that a change is durable; `numbers` are the ids of new events."""
        self.durable, self.version = change.durable, change.version + 1
        for event, _, _ in change.events:
            event.number = numbers.get(event, event.number)


class Boots:
    """The boots of one surface."""

    def __init__(self, surface: str, hold_ms: float) -> None:
        self._surface, self._hold_ms = surface, hold_ms
        self._boots: dict[str, Boot] = {}
        self.lost = 0
        """Samples that their sender no longer had."""

    def get(self, boot_id: str) -> Boot | None:
        """Return a boot; None if it has yet to be read."""
        return self._boots.get(boot_id)

    def put(self, batch: Batch, model: ModelFile, cursors: list[Cursor]) -> None:
        """Take what is on record of the boot of a batch, and of others that have an open event."""
        for cursor in cursors:
            if cursor.boot_id not in self._boots:
                self._boots[cursor.boot_id] = self._restored(cursor, model)
        first = batch.oldest or (batch.samples[0].sequence if batch.samples else None)
        if batch.boot_id not in self._boots and first is not None:
            self._boots[batch.boot_id] = Boot(self._course(batch.boot_id, model), first - 1)

    def hear(self, batch: Batch, *, is_newest: bool) -> None:
        """Note what a batch says of lost samples and of other boots.

        Unless it is of the sender of the newest sample, it may have been sent before another boot began.
        """
        boot = self._boots[batch.boot_id]
        if batch.oldest is not None and boot.has_room:
            self.lost += boot.pass_to(batch.oldest)
        for boot_id, other in self._boots.items() if is_newest else ():
            if other.course.event and boot_id not in (batch.boot_id, *batch.earlier):
                other.course.lose()

    def adopt(self, model: ModelFile) -> None:
        """Decide with this model from now on."""
        for boot_id, boot in self._boots.items():
            if boot.course.model is not model:
                boot.course.lose()
                changed, boot.course = boot.course.take_changed(), self._course(boot_id, model)
                boot.course.changed = changed

    def add(self, batch: Batch, sample: Estimated) -> None:
        """Add a sample of a batch, if it is the one that is expected."""
        boot = self._boots.get(batch.boot_id)
        if boot is None or not boot.has_room:
            return
        if batch.oldest is None:
            self.lost += boot.pass_to(sample.sequence)
        if sample.sequence == boot.expected:
            boot.add(sample)

    def changes(self) -> list[Change]:
        """Return what is not durable, and forget boots that nobody needs."""
        idle = [boot_id for boot_id, boot in self._boots.items() if not boot.is_dirty and not boot.course.event]
        for boot_id in idle[: max(0, len(self._boots) - MAX_EARLIER)]:
            del self._boots[boot_id]
        return [boot.change(self._surface, boot_id) for boot_id, boot in self._boots.items() if boot.is_dirty]

    @property
    def waiting(self) -> int:
        """Number of samples that are not durable."""
        return sum(boot.expected - 1 - boot.durable for boot in self._boots.values())

    def _restored(self, cursor: Cursor, model: ModelFile) -> Boot:
        """Return a boot as it is on record. Another model ends its open event."""
        course = self._course(cursor.boot_id, model)
        number, event = cursor.event or (None, None)
        try:
            if cursor.model != model.identity:
                message = f"another model decided it ({cursor.model})"
                raise ValueError(message)
            course.go_on(cursor.memory, event, number)
        except ValueError as error:
            _log.info("surface %s: an event of boot %s cannot go on: %s", self._surface, cursor.boot_id, error)
            course.lose()
            if event:
                unseen = OpenEvent(event, number)
                unseen.finish(End.UNSEEN)
                course.changed = [unseen]
        return Boot(course, cursor.durable, cursor.version)

    def _course(self, boot_id: str, model: ModelFile) -> Course:
        return Course(self._surface, boot_id, model, self._hold_ms)
