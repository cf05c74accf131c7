"""Parts of the metadata of a model file, each a value that checks itself."""

import math
from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, NonNegativeFloat, PositiveFloat, model_validator

from beamtouch_common.digits import rounded
from beamtouch_common.names import Name
from beamtouch_common.units import MM, Unit
from beamtouch_models.names import Criterion

Deviation = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Pair = Annotated[tuple[FiniteFloat, FiniteFloat], Field(strict=False)]
PositivePair = Annotated[tuple[PositiveFloat, PositiveFloat], Field(strict=False)]


def is_none(value: object) -> bool:
    """Return True for None: a field that is left out where it says nothing."""
    return value is None


class MetadataPart(BaseModel):
    """A part of the metadata. It is immutable; unknown fields and numbers that are not finite are refused."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)

    def __repr__(self) -> str:
        """Return the fields with rounded numbers."""
        shown = [name for name, field in type(self).model_fields.items() if field.repr]
        return f"{type(self).__name__}({', '.join(f'{name}={rounded(getattr(self, name))}' for name in shown)})"

    __str__ = __repr__


def _is_mm(unit: str) -> bool:
    return unit == MM


class Channel(MetadataPart):
    """One sensor of the layout."""

    name: Name
    position_mm: FiniteFloat
    """From the left end of the beam; on a plate, along its first axis."""
    across_mm: FiniteFloat | None = Field(default=None, exclude_if=is_none)
    """Along the second axis; only on a plate."""
    unit: Annotated[Unit, Field(exclude_if=_is_mm)] = MM
    """Unit of its deflection. All figures of deflections, in `_mm` by their names, are in it."""


class Ranges(MetadataPart):
    """The ranges that the model was made for; outside them its answers mean nothing."""

    position_mm: Pair
    """On a plate, along its first axis."""
    across_mm: Pair | None = Field(default=None, exclude_if=is_none)
    """Along the second axis; only on a plate."""
    force_n: PositivePair
    """Evidence of a force beyond it against a contact: `runtime.force_range`. Equal if the force is exact."""


class Sensor(MetadataPart):
    """The sensor and ADC of every channel."""

    rate_hz: PositiveFloat
    range_mm: Pair
    standoff_mm: FiniteFloat
    """Gap at rest, or the value of a sensor that shows no gap."""
    adc_bits: int = Field(ge=6, le=16)
    gain_mm_per_count: FiniteFloat
    offset_mm: FiniteFloat
    """Nominal characteristic: gap in mm = offset + gain x counts."""


class FilterChoice(MetadataPart):
    """The filter between reading and sample that the model was made for."""

    kind: Literal["none", "moving-average", "growing-mean"] = "none"
    window: int = Field(default=1, ge=1)
    """Number of readings whose mean has the noise that the model was made for."""
    longest: int | None = Field(default=None, ge=1)
    """Largest number of readings in a growing mean; null for the other kinds."""
    spike_mm: PositiveFloat | None = None
    """Distance from the median of the last three readings that makes a reading a spike; null: no spike filter."""
    settling_ms: float = Field(default=0.0, ge=0)
    """Time from the first reading of a new load to the first sample of `window` readings of that load alone."""

    @property
    def max_readings(self) -> int:
        """Largest number of readings in a sample."""
        return self.longest or self.window

    def min_noise_mm(self, noise: "Noise") -> float:
        """Return the noise of a sample of the most readings, in mm."""
        return noise.sample_mm * math.sqrt(self.window / self.max_readings)


class Noise(MetadataPart):
    """Standard deviations in mm."""

    reading_mm: Deviation
    sample_mm: Deviation
    """After the filter; the model is made for this noise."""


class Floor(MetadataPart):
    """Errors that calibration leaves and that never average away: standard deviations per channel."""

    gain: list[Deviation]
    """Relative error of the gain."""
    zero_mm: list[Deviation]
    """Error of the zero."""
    drift_mm_per_min: Deviation = 0.0
    """Drift of all zeros together in a minute; 0 if they do not drift."""


class Influence(MetadataPart):
    """The influence at the sensors, as the estimator knows it: with gains and positions of a calibration."""

    mm_per_n: list[list[FiniteFloat]] = Field(min_length=4)
    """For evenly spaced positions of the contact from end to end of the range, the deflection at each sensor. On a
    plate they are a square grid, those of the second axis side by side."""


class DrawnSupport(MetadataPart):
    """A support of the structure, as a page draws it."""

    at_mm: FiniteFloat
    """On a plate, along its first axis."""
    kind: Literal["simple", "fixed", "spring"]
    slides: bool
    """True if the beam can move lengthwise on it."""
    across_mm: FiniteFloat | None = Field(default=None, exclude_if=is_none)
    """Along the second axis; only on a plate."""
    end_mm: Pair | None = Field(default=None, exclude_if=is_none)
    """The other end of a support that is a line on a plate; None if it is a point."""


class BeamDrawing(MetadataPart):
    """The structure as a page draws it: a plate from above, and its shape as a straight line."""

    supports: list[DrawnSupport]
    """From left to right."""
    at_mm: Annotated[list[FiniteFloat], Field(min_length=2)]
    """Positions along the beam at which the deflection is given, ascending."""
    load_mm: Annotated[list[FiniteFloat], Field(min_length=1)]
    """Positions of the contact for which it is given."""
    deflection_mm_per_n: list[list[FiniteFloat]]
    """For each position of the contact, the deflection along the beam."""
    sensor_mm: NonNegativeFloat
    """Width of a sensor's housing."""


Threshold = Annotated[float, Field(ge=0, le=1e6)]
"""Of log odds and sums of squares. A larger one would never be passed, so nothing would ever be noticed."""


class Thresholds(MetadataPart):
    """Thresholds for any covariance, by the number of valid channels; the first entries are for one channel."""

    touch: list[Threshold]
    """A sample is a contact if `contact_log_odds` exceeds this."""
    rest: list[Threshold]
    """Rest does not explain a sample if the sum of squares of the whitened sample exceeds this."""
    misfit: list[Threshold]
    """No single contact explains a sample if `misfit` exceeds this."""
    false_contacts_per_day: PositiveFloat
    """Contacts per day at rest that `touch` was chosen for."""


class SmallestForce(MetadataPart):
    """The smallest force that a settled sample shows along the beam, with all channels."""

    position_mm: Annotated[list[FiniteFloat], Field(min_length=1)]
    """Evenly spaced from end to end of the range, and the supports within it; on a plate, along its first axis."""
    across_mm: list[FiniteFloat] | None = Field(default=None, exclude_if=is_none)
    """Along the second axis; only on a plate."""
    force_n: list[PositiveFloat | None]
    """95 of 100 settled samples at this force are a contact; null: nothing is seen, as at a support."""

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if len(self.force_n) != len(self.position_mm):
            raise ValueError(f"{len(self.position_mm)} positions with {len(self.force_n)} forces")
        if self.across_mm is not None and len(self.across_mm) != len(self.position_mm):
            raise ValueError(f"{len(self.position_mm)} positions with {len(self.across_mm)} across")
        return self


class SinceTouch(MetadataPart):
    """The error of an answer by the time since a touch, behind the filter of the model."""

    since_ms: Deviation
    """Time in which this many readings of the touch have come."""
    readings: int
    error_percent: Deviation
    """Mean |position error| in percent of the length if the beam follows the touch at once."""
    error_standard_error: Deviation
    ringing_percent: Deviation | None = None
    """The same after a sudden force, which rings; None if the scene does not state the beam's mass."""
    ringing_standard_error: Deviation | None = None


class Accuracy(MetadataPart):
    """Mean |position error| in percent of the length (eq. 5 of the paper), over the scene's ranges."""

    error_percent: Deviation
    error_standard_error: Deviation
    limit_percent: Deviation
    limit_standard_error: Deviation
    ratio_standard_error: Deviation
    """Standard error of `ratio`, whose terms share their contacts."""
    since_touch: list[SinceTouch]
    """From the first answer to the longest mean; all figures above are those of a mean of `filter.window` readings."""

    @property
    def ratio(self) -> float:
        """Error over the accuracy limit; no estimator gets below 1."""
        return self.error_percent / self.limit_percent if self.limit_percent else float("nan")


class Golden(MetadataPart):
    """Inputs with the answers that the graph gave when it was built."""

    deflection_mm: list[list[FiniteFloat]] = Field(min_length=1)
    whitening_per_mm: list[list[list[FiniteFloat]]] = Field(min_length=1)
    answers: dict[str, list[FiniteFloat]]


class LayoutErrors(MetadataPart):
    """The placement of a layout; errors are accuracy limits in percent of the length."""

    criterion: Criterion
    failed_percent: float | None = Field(ge=0, le=100)
    """Share of the time in which the worst sensor has failed, for which the layout was placed; None: the criterion does
    not ask."""
    limit_without_percent: list[NonNegativeFloat]
    """With each sensor failed, in the order of the layout; empty for a single sensor. That with all is
    `Accuracy.limit_percent`."""
    limit_without_standard_error: list[Deviation]
