"""The record of one surface in memory: its boots, and the health of its sensors. Pure but for the run of the model."""

from dataclasses import replace
from math import inf

from beamtouch_models.runtime import ModelFile
from beamtouch_service.record.events.boot_record import BootRecord
from beamtouch_service.record.events.changes import Change, Cursor
from beamtouch_service.record.events.event import OpenEvent
from beamtouch_service.record.events.health import HealthHistory
from beamtouch_service.samples import MAX_EARLIER, Batch
from beamtouch_service.surfaces.estimate import Estimate
from beamtouch_service.surfaces.surface import Surface

LATE_S = 3.0
"""Data that nobody waits for become durable this late, as each commit writes at least one page of the disk. With one
commit a second, a sample is durable after at most 4 s. A daemon writes what is not durable after 5 s (its `MEMORY_S`)
to a disk of its own: one second is left for the commit and for the receipt that tells the daemon."""


class SurfaceRecord:
    """How far the record of each boot of a surface is, and what is not durable yet."""

    def __init__(self, surface: Surface, model: ModelFile, health: HealthHistory) -> None:
        self.surface, self.model = surface, model
        self.lost = 0
        """Samples that their sender no longer had."""
        self._is_urgent = False
        """True if somebody waits for the next commit."""
        self._changed_s = -inf
        """When the last change was taken [s, monotonic]."""
        self._health = health
        surface.health = health.state
        self._boots: dict[str, BootRecord] = {}

    @property
    def waiting(self) -> int:
        """Number of samples that are not durable."""
        return sum(boot.expected - 1 - boot.durable for boot in self._boots.values())

    @property
    def boot_ids(self) -> list[str]:
        """The boots that are in memory."""
        return list(self._boots)

    def boot(self, boot_id: str) -> BootRecord | None:
        """Return a boot; None if it has yet to be read."""
        return self._boots.get(boot_id)

    def put(self, batch: Batch, cursors: list[Cursor]) -> None:
        """Take what is on record of the boot of a batch, and of others that have an open event."""
        for cursor in cursors:
            if cursor.boot_id not in self._boots:
                self._boots[cursor.boot_id] = boot = self._new(cursor.boot_id, cursor.durable)
                boot.go_on(cursor)
        first = batch.oldest or (batch.samples[0].sequence if batch.samples else None)
        if batch.boot_id not in self._boots and first is not None:
            self._boots[batch.boot_id] = self._new(batch.boot_id, first - 1)

    def _new(self, boot_id: str, durable: int) -> BootRecord:
        surface = self.surface
        return BootRecord(surface.name, surface.section, boot_id, self.model, durable)

    def adopt(self, model: ModelFile) -> None:
        """Decide with this model from now on."""
        if self.model is model:
            return
        self.model = model
        for boot in self._boots.values():
            boot.adopt(model)
        self._health = HealthHistory(self.surface.name, model, replace(self._health.stored, model=""))
        self.surface.health = self._health.state

    def hear(self, batch: Batch) -> None:
        """Note what a batch says of lost samples and of other boots.

        Unless it is of the sender of the newest sample, it may have been sent before another boot began.
        """
        boot, newest = self._boots[batch.boot_id], self.surface.newest
        # A sender that asks how far the record is waits for it. One that states no oldest sample keeps none.
        self._is_urgent |= not batch.samples or batch.oldest is None
        if batch.oldest is not None and boot.has_room:
            self.lost += boot.pass_to(batch.oldest)
        for boot_id, other in self._boots.items() if newest and newest.boot_id == batch.boot_id else ():
            if other.event and boot_id not in (batch.boot_id, *batch.earlier):
                other.lose()

    def add(self, batch: Batch, estimate: Estimate) -> None:
        """Add a sample of a batch, if it is the one that is expected."""
        boot = self._boots.get(batch.boot_id)
        if boot is None or not boot.has_room:
            return
        if batch.oldest is None:
            self.lost += boot.pass_to(estimate.sample.sequence)
        if estimate.sample.sequence == boot.expected:
            boot.add(estimate)

    def is_due(self, now_s: float) -> bool:
        """Return whether what is not durable yet should be at this time [s, monotonic]."""
        has_ended = any(boot.has_ended for boot in self._boots.values())
        return self._is_urgent or has_ended or now_s - self._changed_s >= LATE_S

    def change(self, now_s: float) -> Change | None:
        """Return what is not durable at this time [s, monotonic], and forget boots that nobody needs."""
        self._is_urgent, self._changed_s = False, now_s
        idle = [boot_id for boot_id, boot in self._boots.items() if not boot.is_dirty and not boot.event]
        for boot_id in idle[: max(0, len(self._boots) - MAX_EARLIER)]:
            del self._boots[boot_id]
        boots = [boot.change() for boot in self._boots.values() if boot.is_dirty]
        best = [one for boot in self._boots.values() for one in boot.take_best()]
        if not boots and not self._health.next:
            return None
        return Change(self.surface.name, boots, best, self._health)

    def take_back(self, change: Change) -> None:
        """Keep a change that could not be made durable."""
        self._is_urgent = True
        for one in change.boots:
            if boot := self._boots.get(one.boot_id):
                boot.take_back(one)

    def note_durable(self, change: Change, numbers: dict[OpenEvent, int]) -> None:
        """Note that a change is durable; `numbers` are the ids of new events."""
        for one in change.boots:
            if boot := self._boots.get(one.boot_id):
                boot.note_durable(one, numbers)
        if change.health.next:
            # The model may have changed meanwhile, and the health with it. It stands in the same rows.
            change.health.stored = self._health.stored = change.health.next
            change.health.next = None
            if change.health is self._health:
                self.surface.health = self._health.state
