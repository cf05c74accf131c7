"""The surface that a model was made for: its layout, ranges, sensors, filter and errors, and the beam as drawn."""

import math
from typing import Annotated, Literal, Self

from pydantic import Field, FiniteFloat, NonNegativeFloat, PositiveFloat, model_validator

from beamtouch_models.metadata.fields import NAME, Deviation, MetadataPart, Pair, PositivePair

_GainError = Annotated[float, Field(ge=0, le=1)]


class Channel(MetadataPart):
    """One sensor of the layout."""

    name: str = Field(pattern=NAME)
    position_mm: FiniteFloat
    """From the left end of the beam."""


class Ranges(MetadataPart):
    """The ranges that the model was made for; outside them its answers mean nothing."""

    position_mm: Pair
    force_n: PositivePair
    """Equal if the force is known."""


class Sensor(MetadataPart):
    """The sensor and ADC of every channel."""

    rate_hz: PositiveFloat
    range_mm: PositivePair
    standoff_mm: PositiveFloat
    """Gap at rest."""
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

    gain: list[_GainError]
    """Relative error of the gain."""
    zero_mm: list[Deviation]
    """Error of the zero."""


class Influence(MetadataPart):
    """The influence at the sensors, as the estimator knows it: with gains and positions of a calibration."""

    mm_per_n: list[list[FiniteFloat]] = Field(min_length=4)
    """For evenly spaced positions of the contact from end to end of the range, the deflection at each sensor."""


class DrawnSupport(MetadataPart):
    """A support of the beam, as a page draws it."""

    at_mm: FiniteFloat
    kind: Literal["simple", "fixed"]
    slides: bool
    """Whether the beam can move lengthwise on it."""


class Drawn(MetadataPart):
    """The beam as a page draws it."""

    supports: list[DrawnSupport]
    """From left to right."""
    at_mm: Annotated[list[FiniteFloat], Field(min_length=2)]
    """Positions along the beam at which the deflection is given, ascending."""
    load_mm: Annotated[list[FiniteFloat], Field(min_length=1)]
    """Positions of the contact for which it is given."""
    deflection_mm_per_n: list[list[FiniteFloat]]
    """For each position of the contact, the deflection along the beam."""
    sensor_mm: NonNegativeFloat
    """Width of a sensor's housing along the beam."""

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        rows = [len(row) for row in self.deflection_mm_per_n]
        if rows != [len(self.at_mm)] * len(self.load_mm):
            raise ValueError(f"deflection_mm_per_n must hold {len(self.load_mm)} rows of {len(self.at_mm)} values")
        if any(list(values) != sorted(set(values)) for values in (self.at_mm, self.load_mm)):
            raise ValueError("at_mm and load_mm must ascend")
        return self
