"""Sensor layouts: the candidate grid and the rules for a layout."""

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from beamtouch_models.arrays import Bools, Floats, Indices
from beamtouch_models.errors import SceneError


@dataclass(frozen=True, eq=False)
class LayoutRules:
    """The positions that a sensor may take, and the rules for a layout.

    A layout is an ascending list of distinct candidates, at least `min_distance_mm` apart, that includes every fixed
    sensor.
    """

    position_mm: Floats
    """(candidates,), ascending, the fixed sensors among them."""
    fixed: Indices
    """Candidates of the fixed sensors, ascending."""
    min_distance_mm: float

    @cached_property
    def gap_mm(self) -> float:
        """Smallest distance between neighbours, minus a tolerance for rounding of the grid's multiples."""
        step, span = float(np.diff(self.position_mm).min()), float(np.ptp(self.position_mm))
        return max(self.min_distance_mm - 1e-9 * span, step / 2)

    @cached_property
    def last_before(self) -> Indices:
        """For each candidate, the last one to its left that keeps the distance, or -1; (candidates,)."""
        return np.searchsorted(self.position_mm, self.position_mm - self.gap_mm, side="right") - 1

    @cached_property
    def mirrored(self) -> "LayoutRules":
        """The same rules seen from the right end."""
        return LayoutRules(-self.position_mm[::-1], len(self.position_mm) - 1 - self.fixed[::-1], self.min_distance_mm)

    def allowed(self, layouts: Indices) -> Bools:
        """Return whether each layout (population, sensors) keeps the distance and has all fixed sensors."""
        positions = np.sort(self.position_mm[layouts], axis=1)
        kept: Bools = np.all(np.diff(positions, axis=1) >= self.gap_mm, axis=1)
        for index in self.fixed:
            kept &= np.any(layouts == index, axis=1)
        return kept

    def fitted(self, wanted_mm: Floats) -> Indices | None:
        """Return the allowed layout nearest to wanted positions (sensors,); None if no layout exists."""
        span = self.position_mm[-1] - self.position_mm[0]
        return self.best(-(((np.sort(wanted_mm)[:, None] - self.position_mm) / span) ** 2))

    def best(self, values: Floats) -> Indices | None:
        """Return the layout with the largest sum of values (sensors, candidates), or None.

        Row k holds the values of the k-th sensor from the left. Dynamic programming over the sensors finds the layout;
        None means that no allowed layout has finite values.
        """
        sums = self._sums_from_left(values)
        last = sums[-1].copy()
        if len(self.fixed):
            last[: self.fixed[-1]] = -np.inf
        if not np.isfinite(last.max()):
            return None
        layout = [int(last.argmax())]
        for row in sums[-2::-1]:
            # The one before stands at or after the last fixed sensor on its side.
            before = self.fixed[self.fixed < layout[-1]]
            low = int(before[-1]) if len(before) else 0
            layout.append(low + int(row[low : self.last_before[layout[-1]] + 1].argmax()))
        return np.array(layout[::-1], dtype=np.intp)

    def best_through(self, values: Floats) -> Floats:
        """Return the largest sum of values of a layout whose k-th sensor is at i, or -inf; (sensors, candidates)."""
        left = self._sums_from_left(values)
        right = self.mirrored._sums_from_left(values[::-1, ::-1])[::-1, ::-1]
        through = np.full_like(values, -np.inf)
        usable = np.isfinite(values)
        through[usable] = left[usable] + (right[usable] - values[usable])
        return through

    def _sums_from_left(self, values: Floats) -> Floats:
        """Return the largest sum of the first k + 1 values with the k-th sensor at i; (sensors, candidates)."""
        sums = np.full_like(values, -np.inf)
        first = self.fixed[0] if len(self.fixed) else len(self.position_mm) - 1
        sums[0, : first + 1] = values[0, : first + 1]
        # The predecessor of a sensor is at or after the last fixed sensor before it, which must not be skipped.
        bounds = [0, *(int(index) + 1 for index in self.fixed), len(self.position_mm)]
        for k in range(1, len(values)):
            for start, end in pairwise(bounds):
                low = max(start - 1, 0)
                running = np.maximum.accumulate(sums[k - 1, low:end])
                before = self.last_before[start:end] - low
                reached = np.where(before >= 0, running[np.maximum(before, 0)] if len(running) else -np.inf, -np.inf)
                sums[k, start:end] = values[k, start:end] + reached
        return sums


def equal_pitch_mm(length_mm: float, count: int) -> Floats:
    """Return the layout that divides the beam into equal parts; (count,) in mm."""
    return length_mm * np.arange(1, count + 1) / (count + 1)


def equal_layout(rules: LayoutRules, length_mm: float, count: int) -> Indices:
    """Return the allowed layout nearest to equal pitch on a beam of this length; SceneError if no layout exists."""
    if count < len(rules.fixed):
        raise SceneError(f"sensors.fixed_mm has {len(rules.fixed)} sensors, more than the {count} to be placed")
    layout = rules.fitted(equal_pitch_mm(length_mm, count))
    if layout is None:
        raise SceneError(
            f"no layout of {count} sensors keeps the rules of sensors (size_mm, min_distance_mm, keep_out_mm, "
            "fixed_mm, grid_mm, mounting_tolerance_mm); loosen one or use fewer sensors"
        )
    return layout
