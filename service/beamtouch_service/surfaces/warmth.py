"""Warmth: whether zeros that moved together explain the samples that nothing else explains. Pure.

A hall that warms moves the zeros of all sensors alike. No load does, so a stretch of samples in which all channels are
off by about the same is warmth before it is anything else.
"""

from collections import deque

import numpy as np

from beamtouch_models.runtime import Evidence, Thresholds

FEWEST = 3
"""Fewest channels: two are moved alike by a load between them."""
SAMPLES, AGREEING = 40, 0.9
"""Number of samples that count, and the part of them that a shift must explain."""


def shift_of(thresholds: Thresholds, evidence: Evidence) -> float | None:
    """Return by how much all zeros have moved together [mm], if that explains a sample; None if it does not."""
    if evidence.channels < FEWEST:
        return None
    whitened = evidence.whitening_per_mm @ evidence.deflection_mm
    along = evidence.whitening_per_mm.sum(axis=1)
    length = float(along @ along)
    shift_mm = float(along @ whitened) / length
    left = whitened - shift_mm * along
    return shift_mm if float(left @ left) <= thresholds.rest[evidence.channels - 1] else None


class Warmth:
    """The last unexplained samples of one surface, and the shift on which they agree."""

    def __init__(self, thresholds: Thresholds) -> None:
        self._thresholds = thresholds
        self._shifts_mm: deque[float | None] = deque(maxlen=SAMPLES)

    def clear(self) -> None:
        """Forget the samples: the stretch that they belong to is over."""
        self._shifts_mm.clear()

    def add(self, evidence: Evidence) -> None:
        """Add an unexplained sample."""
        self._shifts_mm.append(shift_of(self._thresholds, evidence))

    @property
    def shift_mm(self) -> float | None:
        """By how much all zeros have moved together, as far as the samples so far say."""
        shifts_mm = [one for one in self._shifts_mm if one is not None]
        return float(np.median(shifts_mm)) if len(shifts_mm) >= AGREEING * SAMPLES else None
