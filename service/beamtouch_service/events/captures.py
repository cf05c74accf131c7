"""The samples of unexplained stretches that are kept. Pure."""

from dataclasses import dataclass

from beamtouch_service.surfaces.contradiction import Contradiction

MAX_SAMPLES = 600
"""Samples that are kept of an event, about 0.5 MB for eight channels: a stretch of 18 hours at 200 samples a second."""


@dataclass(frozen=True)
class Capture:
    """Samples of a stretch, in order."""

    model: str
    boot_id: str
    samples: list[Contradiction]
