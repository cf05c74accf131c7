"""Errors of a layout in each part of the structure, and the reason for the position of each sensor.

All is computed: a sensor stands where it stands because of what the error would be without it, and where.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from beamtouch_common.digits import digits
from beamtouch_models.arrays import Bools, Floats, Indices
from beamtouch_models.design.effort import USUAL, Effort
from beamtouch_models.design.physics.influence_function import InfluenceFunction
from beamtouch_models.design.placement.mean_error import MeanError, cell_sizes, mean_error_of, middles_of
from beamtouch_models.places import Extent, distances_mm
from beamtouch_models.runtime.error_model import Errors

CONTACTS, LEAST, CELLS = 4_096, 256, (256, 2048)
"""Usual and smallest number of contacts; smallest and largest number of cells."""
INNER = 0.9
"""Share of the range that is not its ends."""
PARTS, PARTS_OF_PLATE = 10, 4
"""Parts of the range, of a beam and of each axis of a plate, in which a sensor may matter most."""
CONFUSED, HARDLY = 2.0, 1.25
"""Growth of an error, without a sensor, from which the others confuse places, and below which they hardly miss it."""
TINY = float(np.finfo(np.float64).tiny)
BESIDE = 1.25
"""Distance over the least that is allowed, up to which two sensors stand side by side."""


@dataclass(frozen=True)
class Costs:
    """The mean error of a layout over the whole extent of contacts and over parts of it."""

    place_mm: Floats
    """(sensors, axes)."""
    extent: Extent
    at_mm: Floats
    """(cells, axes), the middles of parts of the extent."""
    weight: Floats
    """(cells,), their widths, or areas."""
    error_mm: Floats
    """(cells,), the mean error of the contacts in each."""
    without_mm: Floats
    """(sensors, cells), the same with each sensor failed; empty for a single sensor."""

    def over(self, among: Bools, without: int | None = None) -> float:
        """Return the mean error in mm over some cells (cells,), all sensors working or without one."""
        errors, weight = self.error_mm if without is None else self.without_mm[without], self.weight[among]
        return float(errors[among] @ weight / weight.sum())

    @cached_property
    def everywhere(self) -> Bools:
        """All cells."""
        return np.ones(len(self.at_mm), dtype=np.bool_)

    @cached_property
    def is_inner(self) -> Bools:
        """The cells in the inner nine tenths of the range of each axis."""
        size_mm = self.extent.size_mm
        margin_mm = (1 - INNER) / 2 * size_mm
        inner = np.abs(self.at_mm - self.extent.low_mm - size_mm / 2) <= (size_mm / 2 - margin_mm)
        is_inner: Bools = np.all(inner, axis=1)
        return is_inner

    @property
    def all_mm(self) -> float:
        """The mean error."""
        return self.over(self.everywhere)

    @property
    def inner_mm(self) -> float:
        """The mean error over the inner nine tenths."""
        return self.over(self.is_inner)

    @property
    def ends_mm(self) -> float:
        """The mean error over the outer twentieth at each end, or along the rim."""
        return self.over(~self.is_inner)

    @cached_property
    def failed_mm(self) -> list[float]:
        """The mean error with each sensor failed."""
        return [self.over(self.everywhere, index) for index in range(len(self.without_mm))]

    def part_missed_most(self, index: int) -> Bools:
        """Return the cells in the part of the extent whose error grows by the largest factor without a sensor."""
        along = np.full(self.extent.axes, self.parts)
        number = np.clip(
            ((self.at_mm - self.extent.low_mm) / self.extent.size_mm * along).astype(np.intp), 0, along - 1
        )
        part = np.ravel_multi_index(tuple(number.T), tuple(along))
        sums = [
            np.bincount(part, each * self.weight, int(along.prod())) for each in (self.without_mm[index], self.error_mm)
        ]
        chosen: Bools = part == (sums[0] / np.maximum(sums[1], TINY)).argmax()
        return chosen

    @property
    def parts(self) -> int:
        """Parts of the range of each axis in which a sensor may matter most."""
        return PARTS if self.extent.axes == 1 else PARTS_OF_PLATE

    def part_in_words(self, among: Bools) -> str:
        """Return the part of the extent of the cells that `part_missed_most` returns, in words."""
        low, size = self.extent.low_mm, self.extent.size_mm
        number = np.clip((self.at_mm[among].mean(axis=0) - low) / size * self.parts, 0, self.parts - 1).astype(np.intp)
        ends = zip(low + size * number / self.parts, low + size * (number + 1) / self.parts, strict=True)
        ranges = [f"{digits(float(start), 3)} to {digits(float(end), 3)} mm" for start, end in ends]
        return ranges[0] if len(ranges) == 1 else f"x = {ranges[0]}, y = {ranges[1]}"


def costs_of(
    influence: InfluenceFunction, errors: Errors, layouts: Sequence[Floats], seed: int, effort: Effort = USUAL
) -> list[Costs]:
    """Return the costs of layouts, each (sensors, axes) in mm and of as many sensors, on shared contacts.

    There are more contacts where errors of the first layout are large.
    """
    count = len(layouts[0])
    first = np.arange(count)
    wanted = effort.of(CONTACTS, LEAST)
    mean_error = mean_error_of(
        influence,
        np.concatenate(layouts),
        first,
        errors,
        np.random.default_rng(seed),
        contacts=1 << (wanted - 1).bit_length(),
        cells=CELLS,
        noisy=True,
    )
    return [
        _costs(mean_error, influence.extent, places, first + number * count) for number, places in enumerate(layouts)
    ]


def _costs(mean_error: MeanError, extent: Extent, places: Floats, layout: Indices) -> Costs:
    middles, sizes = middles_of(mean_error.edges_mm), cell_sizes(mean_error.edges_mm)
    failing = range(len(layout) if len(layout) > 1 else 0)
    failed = np.array([mean_error.along_mm(layout, index) for index in failing]).reshape(-1, len(sizes))
    return Costs(places, extent, middles, sizes, mean_error.along_mm(layout), failed)


def reasons_for(costs: Costs, gap_mm: float, is_fixed: Bools) -> list[str]:
    """Return a sentence a sensor, without its end, on why it stands where it stands.

    `gap_mm` is the least distance of two sensors, `is_fixed` (sensors,) which of them the scene fixes.
    """
    if not costs.failed_mm:
        return ["the only one"]
    found = []
    for index, position in enumerate(costs.place_mm):
        among = costs.part_missed_most(index)
        where, grown = costs.part_in_words(among), costs.failed_mm[index] / costs.all_mm
        beside = [
            f"s{other + 1}"
            for other, place in enumerate(costs.place_mm)
            if other != index and gap_mm > 0 and distances_mm(place - position) <= BESIDE * gap_mm
        ]
        what = (
            "the scene fixes it here"
            if is_fixed[index]
            else f"side by side with {' and '.join(beside)}: their noise averages, and either may fail"
            if beside and grown < HARDLY
            else f"keeps apart places that the others confuse, most at {where}"
            if grown >= CONFUSED
            else f"tells most about {where}"
        )
        found.append(
            f"{what}; without it the error there is {_mm(costs.over(among, index))} instead of "
            f"{_mm(costs.over(among))}, and {_mm(costs.failed_mm[index])} instead of {_mm(costs.all_mm)} overall"
            if f"at {where}" in what or f"about {where}" in what
            else f"{what}; without it the error is {_mm(costs.failed_mm[index])} instead of {_mm(costs.all_mm)}, and "
            f"{_mm(costs.over(among, index))} instead of {_mm(costs.over(among))} at {where}"
        )
    return found


def in_parts(costs: Costs) -> str:
    """Say what a layout costs in which part of the range, and with the worst sensor failed."""
    failed = f"; {_mm(max(costs.failed_mm))} with the worst sensor failed" if costs.failed_mm else ""
    ends = "at each end" if costs.extent.axes == 1 else "along the rim"
    return (
        f"mean {_mm(costs.all_mm)}, {_mm(costs.inner_mm)} over the inner 90 %, {_mm(costs.ends_mm)} over the outer 5 % "
        f"{ends}{failed}"
    )


def _mm(value: float) -> str:
    return f"{digits(value, 3)} mm"
