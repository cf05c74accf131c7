"""Interface for the durations of a surface's work."""

from dataclasses import dataclass, field
from typing import Protocol


class Observer(Protocol):
    """Takes durations, as a histogram does."""

    def observe(self, amount: float) -> None:
        """Note a duration [s]."""


class _Nobody:
    def observe(self, amount: float) -> None:
        """Note nothing."""


@dataclass
class Timings:
    """Receivers of the durations of one surface."""

    inference_s: Observer = field(default_factory=_Nobody)
    """Time per estimate."""
    arrival_age_s: Observer = field(default_factory=_Nobody)
    """Age of the newest sample of a batch at its arrival. Late batches are not counted."""
