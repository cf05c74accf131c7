"""The newest sample of a surface, and the contact that it gives."""

from dataclasses import dataclass
from typing import NamedTuple

from beamtouch_service.samples import Sample
from beamtouch_service.surfaces.contact import Contact, ContactQuality, Decision, rfc3339
from beamtouch_service.surfaces.follower import Seen


@dataclass(frozen=True, slots=True)
class Newest:
    """The newest sample and the decision on it."""

    boot_id: str
    channels: list[str]
    """The names of the values in the sample."""
    sample: Sample
    acquired_s: float
    notes: list[str]
    """Notes on the sender: its own, and `noise` if its noise contradicts the model."""
    seen: Seen | None = None
    """None without a model."""
    model: str = ""
    """Identity of the model that answered."""

    def age_ms(self, now_s: float) -> float:
        """Return the age at `now_s` [s, monotonic], rounded."""
        return round((now_s - self.acquired_s) * 1e3, 1)


class Decided(NamedTuple):
    """The newest sample with its decision."""

    newest: Newest
    seen: Seen
    decision: Decision

    @property
    def all_notes(self) -> list[str]:
        """Notes on the sender and on the sample."""
        return [*self.newest.notes, *self.decision.notes]

    def contact(self, surface: str, now_s: float) -> Contact:
        """Return the contact on a surface as of `now_s` [s, monotonic]."""
        newest, estimated = self.newest, self.seen.estimated
        degraded = list(estimated.bad)
        return Contact(
            surface=surface,
            state=self.decision.state,
            readings=estimated.readings,
            misfit=round(self.decision.misfit, 2),
            **self.decision.figures._asdict(),
            age_ms=newest.age_ms(now_s),
            sampled_at=rfc3339(newest.sample.acquired_unix_us),
            sequence=newest.sample.sequence,
            quality=ContactQuality.DEGRADED if degraded else ContactQuality.GOOD,
            degraded_channels=degraded,
            notes=self.all_notes,
            model=newest.model,
        )
