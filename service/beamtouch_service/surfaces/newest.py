"""The newest sample of a surface."""

from dataclasses import dataclass

from beamtouch_service.samples import Sample
from beamtouch_service.surfaces.touch import Seen


@dataclass(frozen=True, slots=True)
class Newest:
    """The newest sample and the decision on it."""

    boot_id: str
    channels: list[str]
    """The names of the values in the sample."""
    sample: Sample
    acquired_s: float
    notes: list[str]
    """On its sender: what it notes itself, and whether its noise contradicts the model."""
    seen: Seen | None = None
    """None without a model."""
    model: str = ""
    """Identity of the model that answered."""

    def age_ms(self, now_s: float) -> float:
        """Return the age at `now_s` [s, monotonic], rounded."""
        return round((now_s - self.acquired_s) * 1e3, 1)
