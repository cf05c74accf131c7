"""Zones of a surface: the keys of a zone, and how the interval of a contact lies to it. Pure.

The service answers by this for each sample; `design-sensors explain --zones` forecasts its answers.
"""

from collections.abc import Mapping
from enum import StrEnum
from typing import Annotated, NamedTuple, Self

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, model_validator

from beamtouch_common.names import Name

HOLD = 1.32
"""An answer ends once the 95 % interval, widened to this many times its half-widths, no longer shows it: 99 % for a
normal distribution, so that a contact on the very edge is on the wrong side in 0.5 % of the answers."""
BEGIN = 1.68
"""Likewise, an answer begins at 99.9 %: hysteresis may only make an answer harder to begin, not easier to keep."""
MAX_ZONES = 6
"""Zones of one surface: as many as its block of Modbus registers has room for."""

ZoneName = Name
_Force = Annotated[FiniteFloat, Field(ge=0)]


class ZoneState(StrEnum):
    """The relation of a contact to a zone."""

    INSIDE = "inside"
    """All of its interval has been in the zone for as long as the dwell."""
    OUTSIDE = "outside"
    """None of its interval is in the zone, or the beam is clear."""
    UNSURE = "unsure"
    """Neither."""


class Span(NamedTuple):
    """A figure with its 95 % interval."""

    middle: float
    low: float
    high: float

    def widened(self, times: float) -> tuple[float, float]:
        """Return the interval whose half-widths are that many times those of this one."""
        return self.middle - times * (self.middle - self.low), self.middle + times * (self.high - self.middle)


class Zone(BaseModel):
    """One zone: a part of the beam, and of the forces if it states a bound."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, use_attribute_docstrings=True)

    from_mm: Annotated[FiniteFloat, Field(ge=0)]
    """Its left edge, from the left end of the beam. 0: the zone begins with the beam."""
    to_mm: Annotated[FiniteFloat, Field(gt=0)]
    """Its right edge. The length of the beam: the zone ends with the beam."""
    least_force_n: _Force | None = None
    """Least force of a contact in it. Without it, there is no lower bound."""
    largest_force_n: _Force | None = None
    """Largest force of a contact in it. Without it, there is no upper bound."""
    dwell_ms: Annotated[FiniteFloat, Field(ge=0, le=3_600_000)] = 0.0
    """A contact must have been in it for this long, without a break, before the answer is `inside`."""

    @model_validator(mode="after")
    def _ascends(self) -> Self:
        if self.from_mm >= self.to_mm:
            raise ValueError(f"from_mm = {self.from_mm:g} must be less than to_mm = {self.to_mm:g}")
        least, largest = self.least_force_n, self.largest_force_n
        if least is not None and largest is not None and least >= largest:
            raise ValueError(f"least_force_n = {least:g} must be less than largest_force_n = {largest:g}")
        return self

    @property
    def has_force(self) -> bool:
        """True if it states a bound of the force."""
        return self.least_force_n is not None or self.largest_force_n is not None

    def conflict(self, length_mm: float, *, estimates_force: bool) -> str:
        """Return why a beam of this length, or a model with or without the force, has no such zone; empty if it has."""
        if self.to_mm > length_mm:
            return f"to_mm = {self.to_mm:g} is beyond the end of the beam, which is {length_mm:g} mm long"
        if self.has_force and not estimates_force:
            return 'a bound of the force needs a scene with "force" in its descriptors'
        return ""

    def lies(self, position: Span, force: Span | None, length_mm: float, times: float) -> ZoneState:
        """Return how the interval of a contact, widened to `times` its half-widths, lies to the zone.

        An interval ends with the beam, of this length: a contact is not beyond its ends.
        """
        low, high = position.widened(times)
        axes = [(max(low, 0.0), min(high, length_mm), self.from_mm, self.to_mm)]
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


def first_conflict(zones: Mapping[str, Zone], length_mm: float, *, estimates_force: bool) -> str:
    """Return the name of the first zone that has a conflict, and the conflict; empty if none has."""
    for name, zone in zones.items():
        if conflict := zone.conflict(length_mm, estimates_force=estimates_force):
            return f"{name}: {conflict}"
    return ""
