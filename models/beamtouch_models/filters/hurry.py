"""Notices zeros that drift faster than is stated, before answers become wrong. Numpy only.

A zero that is followed stays near a point that moves at most twice as fast as the stated drift. Noise does not keep it
at the end of that leash; a faster drift, or a load that comes slowly, does.
"""

from collections import deque
from typing import NamedTuple

import numpy as np

from beamtouch_models.filters.readings import FloatArray

STRAINED_S = 3.0
"""Time at the end of the leash, less the time within it, from which on a drift is too fast. As long as the drift is as
stated, it stays below a third of this."""
MOST_S = 9.0
"""Largest such time that is counted: a drift that slows down is forgotten after as long a rest."""
SMOOTHS_S = 1.0
"""Time over which the means are smoothed that tell the rate."""
BASES_S, BASES = 5.0, 5
"""Means are remembered so often, and so many of them: the rate is the change since the oldest one."""
MINUTE_S = 60.0


class Hurried(NamedTuple):
    """The zero that drifts faster than is stated."""

    channel: int
    mm_per_min: float


class Hurry:
    """How long zeros have strained at the leash. Add the blocks of a rest; a load changes nothing."""

    def __init__(self) -> None:
        self.hurried: Hurried | None = None
        """None while no drift is too fast."""
        self._strained_s = 0.0
        self._newest: tuple[float, FloatArray] | None = None
        """Time of the last block, and the smoothed means."""
        self._bases: deque[tuple[float, FloatArray]] = deque(maxlen=BASES)

    def add(self, at_s: float, block_s: float, mean_mm: FloatArray, *, strains: bool) -> None:
        """Add a block of readings at rest that ends at a time, and whether it moves a zero to the end of its leash."""
        self._strained_s = min(max(self._strained_s + (block_s if strains else -block_s), 0.0), MOST_S)
        last_s, before_mm = self._newest or (at_s, mean_mm)
        smooth_mm = mean_mm + np.exp((last_s - at_s) / SMOOTHS_S) * (before_mm - mean_mm)
        self._newest = at_s, np.where(np.isnan(smooth_mm), np.where(np.isnan(mean_mm), before_mm, mean_mm), smooth_mm)
        if not self._bases or at_s - self._bases[-1][0] >= BASES_S:
            self._bases.append(self._newest)
        begun_s, first_mm = self._bases[0]
        if not self._strained_s:
            self.hurried = None
        elif self._strained_s >= STRAINED_S and at_s > begun_s:
            rates = np.nan_to_num(MINUTE_S * (self._newest[1] - first_mm) / (at_s - begun_s))
            fastest = int(np.abs(rates).argmax())
            self.hurried = Hurried(fastest, float(rates[fastest]))
