"""The drift of a surface's zeros as its daemon follows it: its rate, and how far from the last tare it may go."""

from beamtouch_models.design.pricing.noise import ReadingErrors
from beamtouch_models.filters import Walk
from beamtouch_models.runtime.metadata import Metadata

MOST = 0.5
"""Part of the deflection under the smallest force that counts as drift at most: that force still shows behind it."""
START_DEVIATIONS = 4.0
"""Zeros may be this many standard deviations off after a tare, so that many count as drift at least."""


def smallest_mm(metadata: Metadata) -> list[float]:
    """Return the deflection of each channel under the smallest force, where that moves it most [mm]."""
    least_n = metadata.ranges.force_n[0]
    return [least_n * max(map(abs, column)) for column in zip(*metadata.influence.mm_per_n, strict=True)]


def walk_of(metadata: Metadata, readings: ReadingErrors) -> Walk | None:
    """Return the drift of a model's surface with these errors of its readings; None if zeros do not drift.

    A surface without noise has none either: nothing tells a drift from a load there.
    """
    if not (readings.drift_mm_per_min and metadata.noise.reading_mm):
        return None
    most_mm = max(MOST * min(smallest_mm(metadata)), START_DEVIATIONS * readings.drift_mm)
    return Walk(readings.drift_mm_per_min, most_mm, readings.drift_mm) if most_mm else None
