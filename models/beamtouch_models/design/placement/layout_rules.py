"""Sensor layouts: the places that a sensor may take, and the rules for a layout.

A layout is an array of candidates (sensors,), ascending. Distances are those between places, and a sensor moves to
neighbours on the grid of the candidates, so that beams and plates are placed alike.
"""

from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np
from scipy.optimize import linear_sum_assignment

from beamtouch_models.arrays import Bools, Floats, Indices
from beamtouch_models.design.placement.line_layouts import LineLayouts
from beamtouch_models.errors import SceneError
from beamtouch_models.places import along_axis


@dataclass(frozen=True, eq=False)
class LayoutRules:
    """The places that a sensor may take, and the rules for a layout.

    A layout is a list of distinct candidates, at least `min_distance_mm` apart, that includes every fixed sensor.
    """

    place_mm: Floats
    """(candidates, axes), the fixed sensors among them, ascending by the first axis, then by the next."""
    fixed: Indices
    """Candidates of the fixed sensors, ascending."""
    min_distance_mm: float

    @property
    def axes(self) -> int:
        """Number of axes."""
        return len(self.place_mm[0])

    @cached_property
    def _ticks(self) -> list[Floats]:
        """The coordinates along each axis that candidates have."""
        return [np.unique(column) for column in self.place_mm.T]

    @cached_property
    def _on_grid(self) -> Indices:
        """(candidates, axes), the number of each coordinate among those of its axis."""
        columns = zip(self._ticks, self.place_mm.T, strict=True)
        return np.stack([np.searchsorted(ticks, column) for ticks, column in columns], axis=1)

    @cached_property
    def _candidate_at(self) -> Indices:
        """The candidate at each place of the grid, or -1; an array with the coordinates of each axis."""
        candidate_at = np.full([len(ticks) for ticks in self._ticks], -1, dtype=np.intp)
        candidate_at[tuple(self._on_grid.T)] = np.arange(len(self.place_mm))
        return candidate_at

    @property
    def ticks_across(self) -> int:
        """Number of coordinates of the axis that has most."""
        return int(max(self._candidate_at.shape))

    @cached_property
    def gap_mm(self) -> float:
        """Smallest distance between sensors, minus a tolerance for rounding of the grid's multiples."""
        step = min(float(np.diff(ticks).min(initial=np.inf)) for ticks in self._ticks)
        span = float(np.ptp(self.place_mm, axis=0).max())
        return max(self.min_distance_mm - 1e-9 * span, step / 2)

    @cached_property
    def on_line(self) -> LineLayouts:
        """The layouts of a beam; ValueError if there are more axes."""
        (position_mm,) = self.place_mm.T
        return LineLayouts(position_mm, self.fixed, self.gap_mm)

    def allowed(self, layouts: Indices) -> Bools:
        """Return whether each layout (population, sensors) keeps the distance and has all fixed sensors."""
        places = self.place_mm[layouts]
        if self.axes == 1:  # neighbours will do, and many sensors have many pairs
            apart = np.diff(np.sort(places[..., 0], axis=1), axis=1)
        else:
            pairs = np.array(list(combinations(range(layouts.shape[1]), 2)), dtype=np.intp).reshape(-1, 2)
            apart = np.linalg.norm(places[:, pairs[:, 0]] - places[:, pairs[:, 1]], axis=2)
        allowed: Bools = np.all(apart >= self.gap_mm, axis=1)
        for index in self.fixed:
            allowed &= np.any(layouts == index, axis=1)
        return allowed

    def moved(self, layout: Indices, steps: Indices) -> Indices:
        """Return a layout (sensors,) moved by steps (moves, sensors, axes) on the grid, (moves, sensors).

        It is -1 where a sensor would leave the candidates.
        """
        there = self._on_grid[layout] + steps
        shape = np.array(self._candidate_at.shape)
        is_inside = np.all((there >= 0) & (there < shape), axis=2)
        moved: Indices = np.where(
            is_inside, self._candidate_at[tuple(np.moveaxis(np.clip(there, 0, shape - 1), 2, 0))], -1
        )
        return moved

    def pushed(self, layout: Indices, steps: Indices) -> Indices:
        """Like `moved`, but a sensor goes no farther than the ends of the grid, and stays where no candidate is."""
        shape = np.array(self._candidate_at.shape)
        there = np.clip(self._on_grid[layout] + steps, 0, shape - 1)
        candidates = self._candidate_at[tuple(np.moveaxis(there, 2, 0))]
        return np.where(candidates >= 0, candidates, layout)

    def evenly(self, count: int) -> Indices:
        """Return candidates spread evenly along each axis, about `count`; all where a plane has no more of them.

        Sensors that were measured stand anywhere, and hardly any place of the grid of their coordinates is taken.
        """
        if self.axes > 1 and len(self.place_mm) <= count:
            return np.arange(len(self.place_mm))
        along = max(2, along_axis(count, self.axes))
        ticks = [np.linspace(0, len(ticks) - 1, along).round().astype(np.intp) for ticks in self._ticks]
        candidates = self._candidate_at[np.ix_(*ticks)].ravel()
        return candidates[candidates >= 0]

    def fitted(self, wanted_mm: Floats) -> Indices | None:
        """Return the allowed layout nearest to wanted places (sensors, axes), or None.

        On one axis it is the nearest, and None says that no layout exists. On more, sensors take the nearest place that
        is left, one after the other, and None says that this did not end.
        """
        if self.axes == 1:
            span = self.place_mm[-1] - self.place_mm[0] or 1.0  # there may be one candidate
            return self.on_line.best(-(((np.sort(wanted_mm, axis=0) - self.place_mm.T) / span) ** 2))
        if len(wanted_mm) < len(self.fixed):
            return None
        apart = np.linalg.norm(wanted_mm[:, None] - self.place_mm, axis=2)
        rows_of_fixed, _ = linear_sum_assignment(apart[:, self.fixed])
        layout = self.fixed.tolist()
        for row in np.setdiff1d(np.arange(len(wanted_mm)), rows_of_fixed):
            to_taken = np.linalg.norm(self.place_mm[:, None] - self.place_mm[layout], axis=2)
            is_free = to_taken.min(axis=1, initial=np.inf) >= self.gap_mm
            if not is_free.any():
                return None
            layout.append(int(np.where(is_free, apart[row], np.inf).argmin()))
        found = np.sort(np.array(layout, dtype=np.intp))
        return found if self.allowed(found[None])[0] else None


def equal_pitch_mm(size_mm: Floats, count: int) -> Floats:
    """Return the layout that divides a structure of this size (axes,) into equal parts, (count, axes) in mm.

    On a plate it has rows, as many as make the parts about as long as wide.
    """
    if len(size_mm) == 1:
        return size_mm * np.arange(1, count + 1)[:, None] / (count + 1)
    length_mm, width_mm = size_mm
    rows = min(count, max(1, round(float(np.sqrt(count * width_mm / length_mm)))))
    places = []
    for row, sensors in enumerate(np.array_split(np.arange(count), rows)):
        along = equal_pitch_mm(size_mm[:1], len(sensors))
        places.append(np.column_stack([along, np.full(len(sensors), width_mm * (row + 1) / (rows + 1))]))
    return np.concatenate(places)


def equal_layout(rules: LayoutRules, size_mm: Floats, count: int) -> Indices:
    """Return the allowed layout nearest to equal pitch on a structure of this size; SceneError if `fitted` has none."""
    if count < len(rules.fixed):
        raise SceneError(f"sensors.fixed_mm has {len(rules.fixed)} sensors, more than the {count} to be placed")
    if count > (places := len(rules.place_mm)):
        raise SceneError(
            f"{count} sensors do not fit on {places} places, all that the rules of sensors allow (grid_mm, keep_out_mm)"
            f" or that were measured; place {places} or fewer"
        )
    layout = rules.fitted(equal_pitch_mm(size_mm, count))
    if layout is None:
        raise SceneError(
            f"no layout of {count} sensors keeps the rules of sensors (size_mm, min_distance_mm, keep_out_mm, "
            "fixed_mm, grid_mm, mounting_tolerance_mm); loosen one or use fewer sensors"
        )
    return layout
