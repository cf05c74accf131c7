"""Notices zeros that drift faster than is stated, before answers become wrong. Numpy only.

A zero that is followed stays near a point that moves at most twice as fast as the stated drift. Noise does not keep it
at the end of that leash; a faster drift, or a load that comes slowly, does.
"""

import math
from collections import deque
from typing import NamedTuple

import numpy as np

from beamtouch_models.filters.readings import FloatArray

STRAINED_S = 3.0
"""Time at the end of the leash, less the time within it, from which on a drift is too fast. As long as the drift is as
stated, it stays below a third of this."""
MOST_S = 9.0
"""Largest such time that is counted: a drift that slows down is forgotten after as long a rest."""
SMOOTHS_S, SMOOTH_S = 1.0, 2.0
"""Time at rest over which the means are smoothed that tell the rate, and after which they are smooth."""
BASES_S, BASES = 5.0, 5
"""Means are remembered so often, and so many of them: the rate is the change since the oldest one."""
FASTER, NOISES = 1.5, 4.0
"""Least rate that is told, over the stated one, beside so many deviations of the means."""
ALIKE = 0.25
"""The hall warms if half of the other zeros have moved by more than this part of the way of the fastest."""
MINUTE_S = 60.0


class Hurried(NamedTuple):
    """The zero that drifts fastest, and faster than is stated."""

    channel: int
    mm_per_min: float
    is_common: bool
    """True if most zeros drift together."""


class Hurry:
    """How long zeros have strained at the leash. Add the blocks of a rest; a load changes nothing."""

    def __init__(self, stated_mm_per_min: float) -> None:
        self._stated_mm_per_min = stated_mm_per_min
        self.hurried: Hurried | None = None
        """None while no drift is too fast."""
        self._strained_s = 0.0
        self._rested_s = 0.0
        self._smooth_mm: FloatArray | None = None
        self._bases: deque[tuple[float, FloatArray]] = deque(maxlen=BASES)

    def add(self, at_s: float, block_s: float, mean_mm: FloatArray, deviation_mm: FloatArray, *, strains: bool) -> None:
        """Add a block of readings at rest that ends at a time, and whether it moves a zero to the end of its leash.

        A zero that is far from the tare, but still, strains as well. So what is told has also moved since the oldest
        mean, by more than a drift as stated and noise explain.
        """
        self._strained_s = min(max(self._strained_s + (block_s if strains else -block_s), 0.0), MOST_S)
        self._rested_s += block_s
        keeps = math.exp(-block_s / SMOOTHS_S)
        before_mm = mean_mm if self._smooth_mm is None else self._smooth_mm
        smooth_mm = mean_mm + keeps * (before_mm - mean_mm)
        smooth_mm = np.where(np.isnan(smooth_mm), np.where(np.isnan(mean_mm), before_mm, mean_mm), smooth_mm)
        self._smooth_mm = smooth_mm
        if self._rested_s < SMOOTH_S:
            return
        if not self._bases or at_s - self._bases[-1][0] >= BASES_S:
            self._bases.append((at_s, smooth_mm))
        begun_s, first_mm = self._bases[0]
        if not self._strained_s:
            self.hurried = None
        elif self._strained_s >= STRAINED_S and at_s > begun_s:
            minutes, moved_mm = (at_s - begun_s) / MINUTE_S, smooth_mm - first_mm
            noise_mm = math.sqrt(2 * (1 - keeps) / (1 + keeps)) * deviation_mm
            usual_mm = FASTER * self._stated_mm_per_min * minutes + NOISES * noise_mm
            beyond = np.nan_to_num(np.abs(moved_mm) / usual_mm)
            fastest = int(beyond.argmax())
            if beyond[fastest] > 1:
                others = np.flatnonzero(~np.isnan(mean_mm) & (np.arange(len(mean_mm)) != fastest))
                parts = moved_mm[others] / moved_mm[fastest]
                is_common = len(others) > 0 and float(np.median(parts)) > ALIKE
                self.hurried = Hurried(fastest, float(moved_mm[fastest] / minutes), is_common)
