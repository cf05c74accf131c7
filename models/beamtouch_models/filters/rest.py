"""Detects rest, while one growing mean stands for all readings so far.

Readings at rest are tested one by one, on plain numbers, against what the mean explains. The first one that leaves it
ends the rest. So does the next mean that has begun anew, moves, or has lost a channel: a touch too weak for a single
reading to show.
"""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from beamtouch_models.filters.filtered import Filtered
from beamtouch_models.filters.readings import FloatArray

EXPLAINED = 5.0
"""Deviations of a reading from the mean that are explained. Noise leaves them once in two million readings of a
channel, which ends a rest of four channels at 1 kHz once in seven minutes, for a moment."""
SETTLED_PERIODS = 2.0
"""Periods of the slowest motion that the readings of a settled mean span."""
LEAST_SETTLED = 10
"""Fewest readings of a settled mean."""
LEFT_OUT = 0.95
"""Part of the readings that a mean holds at least, without lone spikes."""
ANYTHING = (-math.inf, math.inf)


class Rest:
    """Follows the means of a surface.

    Parameters
    ----------
    unit_mm
        Deviation that readings at rest reach, shape (channels,).
    longest
        Most readings in a mean.
    slowest_period
        Period of the slowest motion, in readings; 0 if it is not known.
    """

    def __init__(self, unit_mm: FloatArray, longest: int, slowest_period: float) -> None:
        self._unit_mm = unit_mm
        self._least = max(LEAST_SETTLED, SETTLED_PERIODS * slowest_period)
        self.most_waiting = int(longest * LEFT_OUT - self._least)
        """Readings that may wait: a mean that is settled and holds them all is no longer than the longest. Not above
        0 if none may."""
        self._good: NDArray[np.bool_] | None = None
        """The channels that were good in the last reading taken."""
        self._bounds: list[tuple[float, float]] = []
        """Counts of each channel that the mean explains, from and to; empty while something happens."""

    @property
    def lasts(self) -> bool:
        """True if nothing happens, as far as the readings taken say."""
        return bool(self._bounds)

    def follow(
        self,
        filtered: Filtered,
        good: NDArray[np.bool_],
        values_mm: FloatArray,
        counts: FloatArray,
        mm_per_count: FloatArray,
    ) -> bool:
        """Take the means of the next readings; return whether nothing happened before and in all of them.

        Parameters
        ----------
        filtered
            Means after each reading; at least one.
        good
            Channels that enter the filter, shape (readings, channels).
        values_mm, counts
            What the filter takes, and the counts that it was made of, of the last reading, shape (channels,).
        mm_per_count
            Change of such a value with a count there, shape (channels,).
        """
        lasted, before, self._good = self.lasts, self._good, good[-1]
        # Noise makes a mean short or moving for a moment. If something has happened, it does not hold all readings.
        held = filtered.readings[-1:].item()  # NaN, of no channel, compares False
        is_settled = (
            self.most_waiting > 0
            and not filtered.moves[-1]
            and held >= LEFT_OUT * (self._least + len(good))
            and before is not None
            and bool((good == before).all())
        )
        self._bounds = self._explained(filtered.mean_mm[-1], values_mm, counts, mm_per_count) if is_settled else []
        return lasted and is_settled

    def explains(self, counts: Sequence[float | None]) -> bool:
        """Return whether the mean explains a reading; None stands for a channel without a count."""
        for count, (low, high) in zip(counts, self._bounds, strict=True):
            if count is None:
                if low > -math.inf:
                    return False
            elif not low <= count <= high:  # NaN is not explained
                return False
        return True

    def _explained(
        self, mean_mm: FloatArray, values_mm: FloatArray, counts: FloatArray, mm_per_count: FloatArray
    ) -> list[tuple[float, float]]:
        """Return the ends of what the mean explains of each channel; anything of one that has no mean."""
        centre = counts + (mean_mm - values_mm) / mm_per_count
        reach = np.abs(EXPLAINED * self._unit_mm / mm_per_count)
        ends = zip((centre - reach).tolist(), (centre + reach).tolist(), strict=True)
        return [ANYTHING if math.isnan(low) else (low, high) for low, high in ends]
