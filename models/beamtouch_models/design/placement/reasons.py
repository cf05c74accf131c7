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
from beamtouch_models.design.placement.mean_error import MeanError, mean_error_of
from beamtouch_models.places import Extent
from beamtouch_models.runtime.error_model import Errors

CONTACTS, LEAST, CELLS = 4_096, 256, (256, 2048)
"""Usual and smallest number of contacts; smallest and largest number of cells."""
INNER = 0.9
"""Share of the range that is not its ends."""
PARTS = 10
"""Parts of the range in which a sensor may matter most."""
CONFUSED, HARDLY = 2.0, 1.25
"""Growth of an error, without a sensor, from which the others confuse places, and below which they hardly miss it."""
TINY = float(np.finfo(np.float64).tiny)
BESIDE = 1.25
"""Distance over the least that is allowed, up to which two sensors stand side by side."""


@dataclass(frozen=True)
class Costs:
    """The mean error of a layout of a beam over the whole range of contacts and over parts of it."""

    position_mm: Floats
    """(sensors,)."""
    extent: Extent
    at_mm: Floats
    """(cells,), the middles of parts of the range."""
    weight: Floats
    """(cells,), their widths."""
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
        """The cells in the inner nine tenths of the range."""
        margin_mm = (1 - INNER) / 2 * self.extent.size_mm[0]
        inner: Bools = np.abs(self.at_mm - self.extent.low_mm[0] - self.extent.size_mm[0] / 2) <= (
            self.extent.size_mm[0] / 2 - margin_mm
        )
        return inner

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
        """The mean error over the outer twentieth at each end."""
        return self.over(~self.is_inner)

    @cached_property
    def failed_mm(self) -> list[float]:
        """The mean error with each sensor failed."""
        return [self.over(self.everywhere, index) for index in range(len(self.without_mm))]

    def part_missed_most(self, index: int) -> Bools:
        """Return the cells in the part of the range whose error grows by the largest factor without a sensor."""
        low, size = self.extent.low_mm[0], self.extent.size_mm[0]
        part = np.clip(((self.at_mm - low) / size * PARTS).astype(np.intp), 0, PARTS - 1)
        sums = [np.bincount(part, each * self.weight, PARTS) for each in (self.without_mm[index], self.error_mm)]
        chosen: Bools = part == (sums[0] / np.maximum(sums[1], TINY)).argmax()
        return chosen

    def range_of(self, among: Bools) -> tuple[float, float]:
        """Return the part of the range, in mm, of the cells that `part_missed_most` returns."""
        low, size = float(self.extent.low_mm[0]), float(self.extent.size_mm[0])
        number = int(np.clip((self.at_mm[among].mean() - low) / size * PARTS, 0, PARTS - 1))
        return low + size * number / PARTS, low + size * (number + 1) / PARTS


def costs_of(
    influence: InfluenceFunction, errors: Errors, layouts: Sequence[Floats], seed: int, effort: Effort = USUAL
) -> list[Costs]:
    """Return the costs of layouts of a beam, each (sensors, 1) in mm and of as many sensors, on shared contacts.

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
    (edges,), failing = mean_error.edges_mm, range(len(layout) if len(layout) > 1 else 0)
    failed = np.array([mean_error.along_mm(layout, index) for index in failing]).reshape(-1, len(edges) - 1)
    middles = (edges[1:] + edges[:-1]) / 2
    return Costs(places[:, 0], extent, middles, np.diff(edges), mean_error.along_mm(layout), failed)


def reasons_for(costs: Costs, gap_mm: float, fixed_mm: Sequence[float]) -> list[str]:
    """Return a sentence a sensor, without its end, on why it stands where it stands.

    `gap_mm` is the least distance of two sensors.
    """
    if not costs.failed_mm:
        return ["the only one"]
    found = []
    for index, position in enumerate(costs.position_mm):
        among = costs.part_missed_most(index)
        (low, high), grown = costs.range_of(among), costs.failed_mm[index] / costs.all_mm
        beside = [
            f"s{other + 1}"
            for other, place in enumerate(costs.position_mm)
            if other != index and gap_mm > 0 and abs(place - position) <= BESIDE * gap_mm
        ]
        where = f"{digits(low, 3)} to {digits(high, 3)} mm"
        what = (
            "the scene fixes it here"
            if position in fixed_mm
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
    return (
        f"mean {_mm(costs.all_mm)}, {_mm(costs.inner_mm)} over the inner 90 %, {_mm(costs.ends_mm)} over the outer 5 % "
        f"at each end{failed}"
    )


def _mm(value: float) -> str:
    return f"{digits(value, 3)} mm"
