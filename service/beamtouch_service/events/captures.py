"""The samples of unexplained stretches that are kept. Pure."""

from dataclasses import dataclass, field

from beamtouch_service.surfaces.contradiction import Contradiction

WHOLE = 200
"""Samples at the beginning of a stretch that are all kept."""
_PER_DOUBLING = 25
"""Samples that are kept each time that the stretch becomes twice as long."""
MAX_SAMPLES = 600
"""Samples that are kept of an event, about 0.5 MB for eight channels: a stretch of 18 hours at 200 samples a second."""


def is_kept(number: int) -> bool:
    """Return whether to keep a sample of a stretch; the first has number 0."""
    if number < WHOLE:
        return True
    doublings = (number // WHOLE).bit_length() - 1
    return number % ((WHOLE // _PER_DOUBLING) << doublings) == 0


@dataclass(frozen=True)
class Capture:
    """Samples of a stretch, in order."""

    model: str
    boot_id: str
    samples: list[Contradiction]


@dataclass
class Stretch:
    """Counts unexplained samples that follow each other, and holds those that have yet to be written."""

    length: int = 0
    waiting: list[Contradiction] = field(default_factory=list)

    def add(self, sample: Contradiction) -> None:
        """Add the next unexplained sample."""
        if is_kept(self.length):
            self.waiting.append(sample)
        self.length += 1

    def end(self) -> None:
        """End the stretch: the next unexplained sample begins another. What waits is kept."""
        self.length = 0

    def take(self) -> list[Contradiction]:
        """Return what has yet to be written."""
        taken, self.waiting = self.waiting, []
        return taken
