"""The outline of a structure: its axes with their lengths. Places count from 0 along each axis. Pure."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

BEAM_AXIS = "position"
"""The only axis of a beam."""
BEAM_AXES = (BEAM_AXIS,)
PLATE_AXES = ("x", "y")
"""The axes of a plate."""


def axes_of(count: int) -> tuple[str, ...]:
    """Return the names of one axis or two."""
    return BEAM_AXES if count == 1 else PLATE_AXES


def kind_of(axes: Sequence[str]) -> str:
    """Return the structure that has these axes, as messages name it."""
    return "beam" if len(axes) == 1 else "plate"


@cache
def names_of(figure: str, unit: str) -> tuple[str, str, str]:
    """Return the names of a figure and of the ends of its 95 % interval, as `x_mm`, `x_low_mm` and `x_high_mm`."""
    return f"{figure}_{unit}", f"{figure}_low_{unit}", f"{figure}_high_{unit}"


class Span(NamedTuple):
    """A figure with its 95 % interval."""

    middle: float
    low: float
    high: float

    def widened(self, times: float) -> tuple[float, float]:
        """Return the interval whose half-widths are that many times those of this one."""
        return self.middle - times * (self.middle - self.low), self.middle + times * (self.high - self.middle)


Place = Mapping[str, Span]
"""Axis -> coordinate [mm] with its interval, in the order of the axes."""


@dataclass(frozen=True)
class Outline:
    """An interval on a beam, a rectangle on a plate."""

    lengths_mm: Mapping[str, float]
    """Axis -> its length."""

    @classmethod
    def of_beam(cls, length_mm: float) -> "Outline":
        """Return the outline of a beam."""
        return cls({BEAM_AXIS: length_mm})

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of the axes."""
        return tuple(self.lengths_mm)

    @property
    def kind(self) -> str:
        """What it is the outline of, as messages name it."""
        return kind_of(self.axes)

    def __str__(self) -> str:
        """Return it in words."""
        lengths = " by ".join(f"{length_mm:.6g}" for length_mm in self.lengths_mm.values())
        return f"a {self.kind} of {lengths} mm"

    def find_miss(self, place: Place) -> str | None:
        """Return the first axis on which an interval misses the structure; None if it reaches it on every axis."""
        for axis, length_mm in self.lengths_mm.items():
            span = place[axis]
            if span.high < 0 or span.low > length_mm:
                return axis
        return None

    def clip(self, axis: str, low_mm: float, high_mm: float) -> tuple[float, float]:
        """Return the part of an interval that lies on the structure: nothing is beyond its ends."""
        return max(low_mm, 0.0), min(high_mm, self.lengths_mm[axis])
