"""Places of a structure, and the extent of those that contacts may have. Numpy only, pure.

A place is a point of the structure, one number an axis. Places are arrays (places, axes) in mm: a beam has one axis, a
plate two.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from beamtouch_models.arrays import Floats


def on_axis(position_mm: Floats) -> Floats:
    """Return the places (places, 1) of positions (places,) on a beam."""
    return position_mm[:, None]


def positions_of(place_mm: Floats) -> Floats:
    """Return the positions (places,) of places on a beam; ValueError if they have more axes than one."""
    if place_mm.shape[1] != 1:
        raise ValueError(f"positions are of one axis, here are {place_mm.shape[1]}")
    return place_mm[:, 0]


Place = float | tuple[float, ...]
"""A place as a user states it: a position on a beam, one number an axis on a plate."""


def in_rows(places_mm: ArrayLike, axes: int) -> Floats:
    """Return places (places, axes) of positions (places,) on a beam, or of places on more axes."""
    return np.reshape(np.asarray(places_mm, dtype=np.float64), (-1, axes))


def as_stated(place_mm: Floats) -> Floats:
    """Return places (..., axes) as users state them: positions (...) on a beam."""
    return place_mm[..., 0] if place_mm.shape[-1] == 1 else place_mm


def in_words(place_mm: ArrayLike) -> str:
    """Return a place in words, without its unit: `120`, or `(120, 80)` on more axes."""
    numbers = [f"{number:g}" for number in np.atleast_1d(place_mm)]
    return numbers[0] if len(numbers) == 1 else f"({', '.join(numbers)})"


def distances_mm(apart_mm: Floats) -> Floats:
    """Return the lengths (...) of vectors between places (..., axes)."""
    lengths: Floats = np.hypot.reduce(np.abs(apart_mm), axis=-1)
    return lengths


def along_axis(count: int, axes: int) -> int:
    """Return how many of `count` places stand side by side along each axis, about, and at least one."""
    return max(1, round(float(count ** (1 / axes))))


@dataclass(frozen=True)
class Extent:
    """The places that contacts may have: a range of each axis.

    >>> Extent(((10, 390), (0, 90))).grid(12).tolist()[:4]
    [[10.0, 0.0], [10.0, 45.0], [10.0, 90.0], [200.0, 0.0]]
    """

    ranges_mm: tuple[tuple[float, float], ...]
    """(axes,), lowest and highest of each axis."""

    @classmethod
    def of_beam(cls, position_mm: tuple[float, float]) -> Self:
        """Return the extent of a range of positions."""
        return cls((position_mm,))

    @property
    def axes(self) -> int:
        """Number of axes."""
        return len(self.ranges_mm)

    @property
    def range_mm(self) -> tuple[float, float]:
        """The range of positions on a beam; ValueError if there are more axes than one."""
        if self.axes != 1:
            raise ValueError(f"a range of positions is of one axis, here are {self.axes}")
        return self.ranges_mm[0]

    @cached_property
    def low_mm(self) -> Floats:
        """(axes,), the lowest of each axis."""
        return np.array([low for low, _ in self.ranges_mm], dtype=np.float64)

    @cached_property
    def high_mm(self) -> Floats:
        """(axes,), the highest of each axis."""
        return np.array([high for _, high in self.ranges_mm], dtype=np.float64)

    @cached_property
    def size_mm(self) -> Floats:
        """(axes,), the lengths of the ranges."""
        return self.high_mm - self.low_mm

    def ticks(self, count: int) -> list[Floats]:
        """Return evenly spaced coordinates of each axis, arrays (ticks,), whose grid has about `count` places."""
        along = max(2, along_axis(count, self.axes))
        return [np.linspace(*ends, along) for ends in self.ranges_mm]

    def grid(self, count: int) -> Floats:
        """Return about `count` places, evenly over the extent; (places, axes), those of the last axis side by side."""
        return grid_of(self.ticks(count))

    def middles(self, along: int) -> Floats:
        """Return the middles of equal parts of the extent, `along` each axis, (parts, axes)."""
        return grid_of(self.middle_ticks(along))

    def middle_ticks(self, along: int) -> list[Floats]:
        """Return the coordinates of these middles along each axis, arrays (along,)."""
        share = (np.arange(along) + 0.5) / along
        return [low + (high - low) * share for low, high in self.ranges_mm]

    def uniform(self, count: int, rng: np.random.Generator) -> Floats:
        """Draw places (count, axes)."""
        return rng.uniform(self.low_mm, self.high_mm, size=(count, self.axes))

    def at(self, share: Floats) -> Floats:
        """Return the places (places, axes) at shares of each range, from 0 to 1."""
        places: Floats = self.low_mm + self.size_mm * share
        return places


def grid_of(ticks: list[Floats]) -> Floats:
    """Return all places (places, axes) whose coordinates are among those of each axis; the last axis varies fastest."""
    return np.stack(np.meshgrid(*ticks, indexing="ij"), axis=-1).reshape(-1, len(ticks))
