"""The tables of a scene beside the beam, strictly validated, and the types of numbers that a user states in a file."""

from typing import Annotated, Literal, Self

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, PositiveInt, model_validator

from beamtouch_models.errors import SceneError

FARTHEST_K = 150.0
"""A beam that is always more than this above its mounting temperature was stated in absolute kelvin."""
FORCE_TOLERANCE_PERCENT = 1.0
"""How far a force may be from the one number that a scene states, unless it says so: a weight that was read off a
kitchen scale, or a spring."""
MIN_SENSORS, MAX_SENSORS = 1, 64
MAX_GAIN_PERCENT = 5.0
"""Largest error of a gain. Up to here, the variance of a sample may be taken from its own deflections instead of those
of each contact that might be its cause."""

Finite = Annotated[float, Field(allow_inf_nan=False)]
PositiveFinite = Annotated[float, Field(gt=0, allow_inf_nan=False)]
DampingRatio = Annotated[float, Field(gt=0, lt=1)]
Fixity = Annotated[float, Field(ge=0, lt=1)]
Pair = Annotated[tuple[Finite, Finite], Field(strict=False)]
PositivePair = Annotated[tuple[PositiveFinite, PositiveFinite], Field(strict=False)]


def _known_well(percent: float) -> float:
    if not percent <= MAX_GAIN_PERCENT:
        raise ValueError(
            f"no surface is built of sensors whose gains are known to worse than {MAX_GAIN_PERCENT:g} % after "
            "calibration; calibrate, or use better sensors"
        )
    return percent


GainError = Annotated[float, Field(ge=0, json_schema_extra={"maximum": MAX_GAIN_PERCENT}), AfterValidator(_known_well)]


class Strict(BaseModel):
    """Base class of what a user states: immutable, refuses unknown keys, converts no types."""

    model_config = ConfigDict(
        extra="forbid", strict=True, frozen=True, use_attribute_docstrings=True, serialize_by_alias=True
    )


class Contact(Strict):
    """The contacts that the surface is designed for, uniform over their ranges."""

    model_config = ConfigDict(
        serialize_by_alias=True,
        json_schema_extra={"oneOf": [{"required": ["position_mm"]}, {"required": ["x_mm", "y_mm"]}]},
    )

    force_n: PositiveFinite | PositivePair
    """One number if the force is known, within `force_tolerance_percent`; otherwise its range. What contradicts a range
    whose largest force is less than twice the smallest is no contact."""
    force_tolerance_percent: Annotated[float, Field(ge=0, lt=100)] | None = None
    """How far the force may be from one number, above or below; by default 1. 0: it is exact."""
    stated_position_mm: Pair | None = Field(default=None, alias="position_mm")
    """Range of positions, from the left end of the beam."""
    x_mm: Pair | None = None
    """On a structure of two axes: range along the first one, in place of `position_mm`."""
    y_mm: Pair | None = None
    """On a structure of two axes: range along the second one."""
    width_mm: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 0.0
    """Length over which a contact presses evenly, centred at its position; on a plate, the side of a square. 0 is a
    point."""

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if isinstance(self.force_n, tuple) and self.force_tolerance_percent is not None:
            raise ValueError(
                f"force_tolerance_percent = {self.force_tolerance_percent:g} is that of one force, and force_n = "
                f"{list(self.force_n)} are two; state the range alone"
            )
        if self.force_range_n[0] > self.force_range_n[1]:
            raise ValueError(f"force_n = {list(self.force_range_n)}: the first must not exceed the second")
        stated = {"position_mm": self.stated_position_mm, "x_mm": self.x_mm, "y_mm": self.y_mm}
        keys = [key for key, ends in stated.items() if ends is not None]
        if keys not in (["position_mm"], ["x_mm", "y_mm"]):
            has = f"{', '.join(keys)}{' alone' if len(keys) == 1 else ''}" if keys else "no range of places"
            raise ValueError(f"it has {has}; state position_mm, or x_mm and y_mm on a structure of two axes")
        for key, ends in stated.items():
            if ends is not None and ends[0] >= ends[1]:
                raise ValueError(f"{key} = {list(ends)}: the first must be less than the second")
        return self

    @property
    def position_mm(self) -> tuple[float, float]:
        """Range of positions on a beam; SceneError on a structure of two axes."""
        if self.stated_position_mm is None:
            raise SceneError("contact has x_mm and y_mm, and this knows structures of one axis, with position_mm, only")
        return self.stated_position_mm

    @property
    def ranges_mm(self) -> tuple[tuple[float, float], ...]:
        """Range of places along each axis."""
        stated = (self.stated_position_mm,) if self.x_mm is None else (self.x_mm, self.y_mm)
        return tuple(ends for ends in stated if ends is not None)

    @property
    def force_range_n(self) -> tuple[float, float]:
        """Smallest and largest force; equal if the force is exact."""
        if isinstance(self.force_n, tuple):
            return self.force_n
        percent = self.assumed_tolerance_percent or self.force_tolerance_percent or 0.0
        return self.force_n * (1 - percent / 100), self.force_n * (1 + percent / 100)

    @property
    def assumed_tolerance_percent(self) -> float | None:
        """Return how far the force may be from the one number, if that is not stated; None if it is, or for a range."""
        is_stated = isinstance(self.force_n, tuple) or self.force_tolerance_percent is not None
        return None if is_stated else FORCE_TOLERANCE_PERCENT


class Environment(Strict):
    """The surroundings of the surface."""

    temperature_range_k: Pair | None = None
    """Lowest and highest temperature, relative to that at which the beam was mounted: [-10, 15]."""
    drift_um_per_min: Annotated[float, Field(ge=0, allow_inf_nan=False)] | None = None
    """How fast zeros drift as the surroundings warm, as a standard deviation: all together, and each by itself half as
    fast; by default 5, as in a hall that warms in the morning (less where the beam hardly bends), or the noise of a
    reading in um where that is larger; with a stated `zero_drift_mm`, this noise. The daemon follows it at each rest.
    0: zeros do not drift."""

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        low, high = self.temperature_range_k or (0.0, 0.0)
        if low > high:
            raise ValueError(f"temperature_range_k = {[low, high]}: the first must not exceed the second")
        if low > FARTHEST_K:
            raise ValueError(
                f"temperature_range_k = {[low, high]}: state it relative to the temperature of mounting, not absolute; "
                f"mounted at 293 K, this is {[low - 293, high - 293]}"
            )
        return self


class Place(Strict):
    """A place on a plate."""

    x_mm: Finite
    """Distance from the left edge."""
    y_mm: Finite
    """Distance from the lower edge."""


class Rectangle(Strict):
    """A part of a plate."""

    x_mm: Pair
    """From and to along x, from the left edge."""
    y_mm: Pair
    """From and to along y, from the lower edge."""

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        for key, (low, high) in (("x_mm", self.x_mm), ("y_mm", self.y_mm)):
            if low >= high:
                raise ValueError(f"{key} = {[low, high]}: the first must be less than the second")
        return self


class Sensors(Strict):
    """The proximity sensors under the beam or the plate, all of the same kind."""

    count: (
        Literal["auto"]
        | Annotated[int, Field(ge=MIN_SENSORS, le=MAX_SENSORS)]
        | Annotated[tuple[PositiveInt, PositiveInt], Field(strict=False)]
    ) = "auto"
    """Number of sensors; "auto" (2 to 8) or a range takes the smallest that meets requirements.position_error_mm."""
    noise_mm: Annotated[float, Field(ge=0, allow_inf_nan=False)] | None = None
    """Standard deviation of a reading, without the ADC's steps if `adc_bits` states them; at most a tenth of the length
    of `range_mm`."""
    noise_percent_of_max: Annotated[float, Field(ge=0, allow_inf_nan=False)] | None = None
    """Standard deviation of a reading in percent of the largest deflection in the scene."""
    gain_error_percent: GainError | None = None
    """Standard deviation of each sensor's gain after calibration, in percent; by default 0.3."""
    zero_drift_mm: Annotated[float, Field(ge=0, allow_inf_nan=False)] | None = None
    """Standard deviation of each sensor's zero since the last tare; by default a fifth of the noise of a reading."""
    mounting_tolerance_mm: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 0.0
    """Standard deviation of each sensor's position along the beam, or along each axis of a plate."""
    rate_hz: PositiveFinite = 100.0
    """Readings per second."""
    range_mm: Pair = (1.0, 4.0)
    """Smallest and largest gap between which the sensor is linear; of other sensors than those of a gap in mm, the
    smallest and largest value, which have no default."""
    standoff_mm: Finite | None = None
    """Gap at rest; by default the travel of the beam is centred in the range. Of sensors that show no gap, the value at
    rest; by default 0, if the range leaves room."""
    adc_bits: Annotated[int, Field(ge=6, le=16)] | None = None
    """Bits of the ADC; by default its steps are not modelled. Rounding that the noise does not average out stays."""
    drift_um_per_k: Annotated[float, Field(ge=0, allow_inf_nan=False)] | None = None
    """Largest drift of a sensor's zero with the temperature. It adds to `zero_drift_mm`."""
    size_mm: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 8.0
    """Width of a sensor's housing along the beam; on a plate, its diameter. Housings do not overlap each other, a
    support or a keep-out, and do not reach beyond an end of the beam or an edge of the plate, a free one included: half
    a target would change the characteristic. 0: sensors are points, and may stand at a free end."""
    min_distance_mm: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 0.0
    """Smallest distance between two sensors, from centre to centre; it holds beside `size_mm`."""
    keep_out_mm: list[Pair] = Field(default_factory=list)
    """Stretches of the beam that no housing may reach into; it may touch their ends."""
    keep_out: Annotated[tuple[Rectangle, ...], Field(strict=False)] = ()
    """The same on a plate, rectangles: [{ x_mm = [0, 40], y_mm = [100, 200] }, ...]."""
    fixed_mm: list[Finite] = Field(default_factory=list)
    """Positions of sensors that are already decided, from the left end to the centre of the housing. They keep the same
    rules as other sensors."""
    fixed: Annotated[tuple[Place, ...], Field(strict=False)] = ()
    """The same on a plate: [{ x_mm = 20, y_mm = 20 }, ...]."""
    stated_grid_mm: PositiveFinite | None = Field(default=None, alias="grid_mm")
    """Sensors are placed at multiples of this, from the left end of the beam or the edges of the plate; by default 1 on
    a beam, and on a plate so that its longer side has some 40, or more if the shorter one would have fewer than 8."""

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if (self.noise_mm is None) == (self.noise_percent_of_max is None):
            raise ValueError("give either noise_mm or noise_percent_of_max")
        if self.range_mm[0] >= self.range_mm[1]:
            raise ValueError(f"range_mm = {list(self.range_mm)}: the first must be less than the second")
        if self.standoff_mm is not None and not self.range_mm[0] <= self.standoff_mm <= self.range_mm[1]:
            raise ValueError(f"standoff_mm = {self.standoff_mm:g} lies outside range_mm = {list(self.range_mm)}")
        for position_mm in self.fixed_mm:
            if self.fixed_mm.count(position_mm) > 1:
                raise ValueError(f"fixed_mm names {position_mm:g} mm twice; two sensors cannot share a position")
        for place in self.fixed:
            if self.fixed.count(place) > 1:
                raise ValueError(
                    f"fixed names {place.x_mm:g}, {place.y_mm:g} mm twice; two sensors cannot share a place"
                )
        if any(start >= end for start, end in self.keep_out_mm):
            raise ValueError("keep_out_mm: the start of a stretch must be less than its end")
        return self

    @property
    def grid_mm(self) -> float:
        """Step of the places of sensors on a beam."""
        return 1.0 if self.stated_grid_mm is None else self.stated_grid_mm

    @property
    def fixed_count(self) -> int:
        """Number of sensors that are already decided."""
        return len(self.fixed_mm) + len(self.fixed)

    @property
    def count_range(self) -> tuple[int, int]:
        """Smallest and largest number of sensors, as stated; "auto" is 2 to 8."""
        if self.count == "auto":
            return 2, 8
        return self.count if isinstance(self.count, tuple) else (self.count, self.count)


Descriptor = Literal["position", "force"]


class Requirements(Strict):
    """Requirements of the surface."""

    position_error_mm: PositiveFinite | None = None
    """Largest mean error; it decides the number of sensors if the scene leaves that open."""
    latency_ms: PositiveFinite | None = None
    """Time from a touch to an answer of the accuracy that the model is made for; by default there is no filter."""
    max_mean_ms: PositiveFinite = 1000.0
    """Time for which the mean of a contact at rest may grow on."""
    false_contacts_per_day: PositiveFinite = 1 / 30
    """Contacts per day that may be stated although nothing touches; by default one a month."""
    failed_percent: Annotated[float, Field(ge=0, le=100, allow_inf_nan=False)] = 10.0
    """Share of the time in which the surface must work although its worst sensor has failed. Sensors are placed so that
    the mean error is least over all of the time: 0 is the time with all sensors, 100 that with the worst one failed."""
    descriptors: Annotated[tuple[Descriptor, ...], Field(strict=False)] = ("position",)
    """Figures that the model states; the position is always one of them."""
