"""The sensors of a scene. Validated strictly."""

from typing import Annotated, Literal, Self

from pydantic import Field, PositiveInt, model_validator

from beamtouch_models.scene.fields import Finite, Pair, PositiveFinite, PositivePair, Strict

MIN_SENSORS, MAX_SENSORS = 1, 64


class Sensors(Strict):
    """The proximity sensors under the beam, all of the same kind."""

    count: (
        Literal["auto"]
        | Annotated[int, Field(ge=MIN_SENSORS, le=MAX_SENSORS)]
        | Annotated[tuple[PositiveInt, PositiveInt], Field(strict=False)]
    ) = "auto"
    """Number of sensors; "auto" (2 to 8) or a range takes the smallest that meets requirements.position_error_mm."""
    noise_mm: Annotated[float, Field(ge=0, allow_inf_nan=False)] | None = None
    """Standard deviation of a reading, without the ADC's steps if `adc_bits` states them."""
    noise_percent_of_max: Annotated[float, Field(ge=0, allow_inf_nan=False)] | None = None
    """Standard deviation of a reading in percent of the largest deflection in the scene."""
    gain_error_percent: Annotated[float, Field(ge=0, le=100)] | None = None
    """Standard deviation of each sensor's gain after calibration, in percent; by default 0.3."""
    zero_drift_mm: Annotated[float, Field(ge=0, allow_inf_nan=False)] | None = None
    """Standard deviation of each sensor's zero since the last tare; by default a fifth of the noise of a reading."""
    mounting_tolerance_mm: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 0.0
    """Standard deviation of each sensor's position along the beam."""
    rate_hz: PositiveFinite = 100.0
    """Readings per second."""
    range_mm: PositivePair = (1.0, 4.0)
    """Smallest and largest gap between which the sensor is linear."""
    standoff_mm: PositiveFinite | None = None
    """Gap at rest; by default the travel of the beam is centred in the range."""
    adc_bits: Annotated[int, Field(ge=6, le=16)] | None = None
    """Bits of the ADC; by default its steps are not modelled. Rounding that the noise does not average out stays."""
    drift_um_per_k: Annotated[float, Field(ge=0, allow_inf_nan=False)] | None = None
    """Largest drift of a sensor's zero with the temperature. It adds to `zero_drift_mm`."""
    size_mm: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 8.0
    """Width of a sensor's housing along the beam. Housings do not overlap each other, a support or a keep-out, and do
    not reach beyond an end of the beam, a free one included: half a target would change the characteristic. 0: sensors
    are points, and may stand at a free end."""
    min_distance_mm: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 0.0
    """Smallest distance between two sensors, from centre to centre; it holds beside `size_mm`."""
    keep_out_mm: list[Pair] = Field(default_factory=list)
    """Stretches of the beam that no housing may reach into; it may touch their ends."""
    fixed_mm: list[Finite] = Field(default_factory=list)
    """Positions of sensors that are already decided, from the left end to the centre of the housing. They keep the same
    rules as other sensors."""
    grid_mm: PositiveFinite = 1.0
    """Sensors are placed at multiples of this, from the left end of the beam."""

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if (self.noise_mm is None) == (self.noise_percent_of_max is None):
            raise ValueError("give either noise_mm or noise_percent_of_max")
        if self.range_mm[0] >= self.range_mm[1]:
            raise ValueError(f"range_mm = {list(self.range_mm)}: the first must be less than the second")
        if self.standoff_mm is not None and not self.range_mm[0] <= self.standoff_mm <= self.range_mm[1]:
            raise ValueError(f"standoff_mm = {self.standoff_mm:g} lies outside range_mm = {list(self.range_mm)}")
        twice = [place for place in self.fixed_mm if self.fixed_mm.count(place) > 1]
        if twice:
            raise ValueError(f"fixed_mm names {twice[0]:g} mm twice; two sensors cannot share a position")
        if any(start >= end for start, end in self.keep_out_mm):
            raise ValueError("keep_out_mm: the start of a stretch must be less than its end")
        return self

    @property
    def count_range(self) -> tuple[int, int]:
        """Smallest and largest number of sensors, as stated; "auto" is 2 to 8."""
        if self.count == "auto":
            return 2, 8
        return self.count if isinstance(self.count, tuple) else (self.count, self.count)

    @property
    def fewest(self) -> int:
        """Smallest number of sensors to consider: never less than the fixed ones."""
        return max(self.count_range[0], len(self.fixed_mm))
