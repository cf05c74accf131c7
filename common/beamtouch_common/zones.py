"""Zones of a surface: the keys of a zone, and how the interval of a contact lies to it. Pure.

The service answers by this for each sample; `design-sensors explain --zones` forecasts its answers.
"""

from collections.abc import Mapping
from enum import StrEnum
from typing import Annotated, Self

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, model_validator

from beamtouch_common.names import Name
from beamtouch_common.outline import BEAM_AXES, BEAM_AXIS, Outline, Place, Span

HOLD = 1.32
"""An answer ends once the 95 % interval, widened to this many times its half-widths, no longer shows it: 99 % for a
normal distribution, so that a contact on the very edge is on the wrong side in 0.5 % of the answers."""
BEGIN = 1.68
"""Likewise, an answer begins at 99.9 %: hysteresis may only make an answer harder to begin, not easier to keep."""
MAX_ZONES = 6
"""Zones of one surface: as many as its block of Modbus registers has room for."""

ZoneName = Name
_Force = Annotated[FiniteFloat, Field(ge=0)]
_Edges = Annotated[tuple[Annotated[FiniteFloat, Field(ge=0)], Annotated[FiniteFloat, Field(gt=0)]], Field(strict=False)]


def _is_none(value: object) -> bool:
    return value is None


class ZoneState(StrEnum):
    """The relation of a contact to a zone."""

    INSIDE = "inside"
    """All of its interval has been in the zone for as long as the dwell."""
    OUTSIDE = "outside"
    """None of its interval is in the zone, or the beam is clear."""
    UNSURE = "unsure"
    """Neither."""


class Zone(BaseModel):
    """One zone: a part of a beam or a rectangle on a plate, and a part of the forces if it states a bound."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, use_attribute_docstrings=True)

    from_mm: Annotated[FiniteFloat, Field(ge=0)] | None = Field(None, exclude_if=_is_none)
    """On a beam: its left edge, from the left end of the beam. 0: the zone begins with the beam."""
    to_mm: Annotated[FiniteFloat, Field(gt=0)] | None = Field(None, exclude_if=_is_none)
    """On a beam: its right edge. The length of the beam: the zone ends with the beam."""
    x_mm: _Edges | None = Field(None, exclude_if=_is_none)
    """On a plate: its two edges across `x`, from the edge of the plate, as `[100, 250]`."""
    y_mm: _Edges | None = Field(None, exclude_if=_is_none)
    """On a plate: its two edges across `y`."""
    least_force_n: _Force | None = None
    """Least force of a contact in it. Without it, there is no lower bound."""
    largest_force_n: _Force | None = None
    """Largest force of a contact in it. Without it, there is no upper bound."""
    dwell_ms: Annotated[FiniteFloat, Field(ge=0, le=3_600_000)] = 0.0
    """A contact must have been in it for this long, without a break, before the answer is `inside`."""

    @model_validator(mode="after")
    def _ascends(self) -> Self:
        keys = {"from_mm", "to_mm", "x_mm", "y_mm"} & self.model_fields_set
        if keys not in ({"from_mm", "to_mm"}, {"x_mm", "y_mm"}):
            raise ValueError("a zone needs from_mm and to_mm on a beam, x_mm and y_mm on a plate")
        for axis, (begin_mm, end_mm) in self.ranges_mm.items():
            if begin_mm >= end_mm:
                begin, end = ("from_mm", "to_mm") if axis == BEAM_AXIS else (f"{axis}_mm[0]", f"{axis}_mm[1]")
                raise ValueError(f"{begin} = {begin_mm:g} must be less than {end} = {end_mm:g}")
        least, largest = self.least_force_n, self.largest_force_n
        if least is not None and largest is not None and least >= largest:
            raise ValueError(f"least_force_n = {least:g} must be less than largest_force_n = {largest:g}")
        return self

    @property
    def has_force(self) -> bool:
        """True if it states a bound of the force."""
        return self.least_force_n is not None or self.largest_force_n is not None

    @property
    def ranges_mm(self) -> dict[str, tuple[float, float]]:
        """Axis -> first and last coordinate of the zone."""
        if self.from_mm is not None and self.to_mm is not None:
            return {BEAM_AXIS: (self.from_mm, self.to_mm)}
        return {axis: edges for axis, edges in (("x", self.x_mm), ("y", self.y_mm)) if edges}

    def conflict(self, outline: Outline, *, estimates_force: bool) -> str:
        """Return why a structure of this outline has no such zone, or a model without the force; empty if it has."""
        if tuple(self.ranges_mm) != outline.axes:
            return f"a zone of {outline} has {'from_mm and to_mm' if outline.axes == BEAM_AXES else 'x_mm and y_mm'}"
        for axis, (_, to_mm) in self.ranges_mm.items():
            length_mm = outline.lengths_mm[axis]
            if to_mm > length_mm and axis == BEAM_AXIS:
                return f"to_mm = {to_mm:g} is beyond the end of the beam, which is {length_mm:g} mm long"
            if to_mm > length_mm:
                return f"{axis}_mm ends at {to_mm:g}, beyond the edge of {outline}: {length_mm:g} mm along {axis}"
        if self.has_force and not estimates_force:
            return 'a bound of the force needs a scene with "force" in its descriptors'
        return ""

    def lies(self, place: Place, force: Span | None, outline: Outline, times: float) -> ZoneState:
        """Return how the interval of a contact, widened to `times` its half-widths, lies to the zone.

        An interval ends with the structure: a contact is not beyond its ends.
        """
        axes = [
            (*outline.clip(axis, *place[axis].widened(times)), begin, end)
            for axis, (begin, end) in self.ranges_mm.items()
        ]
        if self.has_force and force is None:
            return ZoneState.UNSURE
        if self.has_force and force is not None:
            least, largest = self.least_force_n or 0.0, self.largest_force_n
            low, high = force.widened(times)
            axes.append((max(low, 0.0), high, least, float("inf") if largest is None else largest))
        if all(begin <= low and high <= end for low, high, begin, end in axes):
            return ZoneState.INSIDE
        if any(high < begin or low > end for low, high, begin, end in axes):
            return ZoneState.OUTSIDE
        return ZoneState.UNSURE


def first_conflict(zones: Mapping[str, Zone], outline: Outline, *, estimates_force: bool) -> str:
    """Return the name of the first zone that has a conflict, and the conflict; empty if none has."""
    for name, zone in zones.items():
        if conflict := zone.conflict(outline, estimates_force=estimates_force):
            return f"{name}: {conflict}"
    return ""
