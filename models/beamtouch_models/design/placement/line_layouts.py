"""Layouts on a beam whose values add up: the best of all that keep the rules, by dynamic programming."""

from itertools import pairwise

import numpy as np

from beamtouch_models.arrays import Floats, Indices


class LineLayouts:
    """The layouts of ascending, distinct candidates on one axis that keep a distance and have every fixed sensor."""

    def __init__(self, position_mm: Floats, fixed: Indices, gap_mm: float) -> None:
        """Take candidates (candidates,) ascending, the fixed ones among them, and the least distance."""
        self._position_mm, self._fixed, self._gap_mm = position_mm, fixed, gap_mm
        # For each candidate, the last one to its left that keeps the distance, or -1.
        self._last_before = np.searchsorted(position_mm, position_mm - gap_mm, side="right") - 1

    def best(self, values: Floats) -> Indices | None:
        """Return the layout with the largest sum of values (sensors, candidates), or None.

        Row k holds the values of the k-th sensor from the left. None means that no layout has finite values.
        """
        sums = self._sums_from_left(values)
        last = sums[-1].copy()
        if len(self._fixed):
            last[: self._fixed[-1]] = -np.inf
        if not np.isfinite(last.max()):
            return None
        layout = [int(last.argmax())]
        for row in sums[-2::-1]:
            # The one before stands at or after the last fixed sensor on its side.
            before = self._fixed[self._fixed < layout[-1]]
            low = int(before[-1]) if len(before) else 0
            layout.append(low + int(row[low : self._last_before[layout[-1]] + 1].argmax()))
        return np.array(layout[::-1], dtype=np.intp)

    def best_through(self, values: Floats) -> Floats:
        """Return the largest sum of values of a layout whose k-th sensor is at i, or -inf; (sensors, candidates)."""
        left = self._sums_from_left(values)
        last = len(self._position_mm) - 1
        mirrored = LineLayouts(-self._position_mm[::-1], last - self._fixed[::-1], self._gap_mm)
        right = mirrored._sums_from_left(values[::-1, ::-1])[::-1, ::-1]
        through = np.full_like(values, -np.inf)
        usable = np.isfinite(values)
        through[usable] = left[usable] + (right[usable] - values[usable])
        return through

    def _sums_from_left(self, values: Floats) -> Floats:
        """Return the largest sum of the first k + 1 values with the k-th sensor at i; (sensors, candidates)."""
        sums = np.full_like(values, -np.inf)
        # The predecessor of a sensor is at or after the last fixed sensor before it, which must not be skipped.
        bounds = [0, *(int(index) + 1 for index in self._fixed), len(self._position_mm)]
        sums[0, : bounds[1]] = values[0, : bounds[1]]
        for k in range(1, len(values)):
            for start, end in pairwise(bounds):
                low = max(start - 1, 0)
                running = np.maximum.accumulate(sums[k - 1, low:end])
                before = self._last_before[start:end] - low
                reached = np.where(before >= 0, running[np.maximum(before, 0)] if len(running) else -np.inf, -np.inf)
                sums[k, start:end] = values[k, start:end] + reached
        return sums
