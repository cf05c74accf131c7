"""Zero tracking of a surface: its zeros follow what drifts at rest, and each sample says how far they may have drifted.

`beamtouch_models.filters.zeros` has the rule.
"""

from collections.abc import Sequence
from typing import Self

import numpy as np

from beamtouch_daemon.config.settings import Surface
from beamtouch_daemon.processing.filters import slowest_period, steps_mm, walk_of
from beamtouch_models.filters import Filtered, FloatArray, Hurried, Rested, Tracked, Walk, Zeros, beyond_start

DIGITS = 3
FAR = 0.7
"""Part of the limit from which on a drift is told: time to wait for the warmth to settle, and to tare."""


class ZeroTracker:
    """The zeros of one surface."""

    def __init__(self, surface: Surface, walk: Walk, noise_mm: float, rested: Rested) -> None:
        period, channels = slowest_period(surface), len(surface.channels)
        self._walk, self._noise_mm = walk, noise_mm
        self._zeros = Zeros(walk, surface.rate_hz, noise_mm, steps_mm(surface), period, channels, rested)

    @classmethod
    def of(cls, surface: Surface, rested: Rested) -> Self | None:
        """Return that of a surface, from its last rest on; None if it does not track its zeros."""
        walk, noise_mm = walk_of(surface), surface.noise_mm
        if walk is None or noise_mm is None:
            return None
        return cls(surface, walk, noise_mm, rested)

    def track(self, deflection_mm: FloatArray, lost: Sequence[int], filtered: Filtered) -> Tracked:
        """Return the zeros of each reading; arguments as of `Zeros.track`."""
        return self._zeros.track(deflection_mm, lost, filtered)

    @property
    def rested(self) -> Rested:
        """The last rest, before the next reading."""
        return self._zeros.rested

    @property
    def far_mm(self) -> float | None:
        """The largest distance of a zero from the last tare [mm]; None unless it is near the limit."""
        farthest_mm = float(np.abs(self._zeros.zero_mm).max())
        return farthest_mm if farthest_mm >= FAR * self._walk.max_mm else None

    @property
    def hurried(self) -> Hurried | None:
        """The zero that drifts faster than is stated; None if none does."""
        return self._zeros.hurried

    def stated(self, tracked: Tracked, filtered: Filtered) -> list[list[float] | None]:
        """Return what samples say of how far their zeros may have drifted; the samples are of the last readings."""
        count = len(filtered.mean_mm)
        last = Tracked(*(values[len(values) - count :] for values in tracked))
        variance_mm2 = filtered.relative_variance * self._noise_mm**2
        beyond = beyond_start(last, self._walk, filtered.mean_mm, variance_mm2)
        if not beyond.any():
            return [None] * count
        return [[float(f"{mm:.{DIGITS}g}") for mm in pair] if any(pair) else None for pair in beyond.tolist()]
