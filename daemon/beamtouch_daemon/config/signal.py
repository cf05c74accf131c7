"""Settings of the signal chain from counts to samples: filters, zero tracking, channels."""

import math
from itertools import pairwise
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, FiniteFloat, model_validator

from beamtouch_common.units import MM, Unit
from beamtouch_daemon.config import value_types
from beamtouch_daemon.config.sources import Host, Strict
from beamtouch_daemon.config.value_types import ValueType
from beamtouch_models.filters import readings_within
from beamtouch_service.samples import ChannelName

LARGEST = 1e9
"""Largest length [mm], rate and slope: a larger one is a mistake, and figures overflow. Values may be counts."""
CUT_COUNTS = 4.0
CUT_PARTS = 0.001, 0.01
"""An input of 0 to 10 V without its cable shows up to so many counts: at least the first part of the largest one in the
linear range, at most the second."""
NEAR_END = 0.05
"""Counts are near an end of the linear range within this part of it."""
SMALLEST_SLOPE = 1e-12
"""Smallest slope of a characteristic [mm per count]: with it, all counts of 32 bits span 4 um."""


def _not_flat(value: float) -> float:
    if abs(value) < SMALLEST_SLOPE:
        raise ValueError(f"must be at least {SMALLEST_SLOPE:g}, with either sign: every count would give the same gap")
    return value


Positive = Annotated[FiniteFloat, Field(gt=0, le=LARGEST)]
Duration = Annotated[FiniteFloat, Field(gt=0, le=86_400_000)]
"""In ms, up to a day: `noise` prints times up to an hour."""
Length = Annotated[FiniteFloat, Field(ge=-LARGEST, le=LARGEST)]
Count = Annotated[FiniteFloat, Field(ge=-value_types.LARGEST, le=value_types.LARGEST)]
Range = Annotated[tuple[Length, Length], Field(strict=False)]
Counts = Annotated[tuple[Count, Count], Field(strict=False)]
Point = Annotated[tuple[Count, Length], Field(strict=False)]


class _Spike(Strict):
    spike_mm: Positive | None = None
    """A deflection that is further than this from the median of the last three is a spike, and enters no mean. The
    newest one waits for the next one, as it may be a touch."""


class NoFilter(_Spike):
    """Every reading is a sample."""

    kind: Literal["none"] = "none"
    """No filter, the default."""

    @property
    def in_words(self) -> str:
        """The filter in words."""
        return "single readings"


class MovingAverage(_Spike):
    """Mean of the last `window` readings."""

    kind: Literal["moving-average"]
    """Mean of the last readings."""
    window: Annotated[int, Field(ge=1, le=10_000)] = 4
    """Number of readings in the mean."""

    @property
    def in_words(self) -> str:
        """The filter in words."""
        return f"the mean of {self.window} readings"


class GrowingMean(_Spike):
    """Mean of all readings since the load last changed: an answer at once, which sharpens while the load rests."""

    kind: Literal["growing-mean"]
    """Mean of all readings since the load last changed. `design-sensors build` writes this one."""
    max_mean_ms: Annotated[FiniteFloat, Field(gt=0, le=60_000)] = 1000.0
    """Longest time that a mean spans. It bounds `readings` of the samples."""

    window: Annotated[int, Field(ge=1, le=10_000)] = 4
    """Smallest number of readings in the mean while the beam moves."""

    @property
    def in_words(self) -> str:
        """The filter in words."""
        return "a growing mean"

    def longest(self, rate_hz: float) -> int:
        """Return the largest number of readings in a mean."""
        return max(1, readings_within(self.max_mean_ms, rate_hz))


Filter = Annotated[NoFilter | MovingAverage | GrowingMean, Field(discriminator="kind")]


class ZeroTracking(Strict):
    """Follows the drift of the rest gaps at each rest, and says how uncertain they are since."""

    drift_um_per_min: Positive
    """How fast the gaps drift at rest, as a standard deviation: all together as a hall warms, each by itself half as
    fast. What changes more than twice as fast is a load."""
    max_mm: Positive
    """Largest distance from the last tare that counts as drift, either way."""


class Channel(Strict):
    """One sensor: the address of its counts, and their meaning."""

    name: ChannelName
    """Name of the channel, as in the model."""
    position_mm: Length | None = None
    """Place of the sensor, from the left end of the beam. `design-sensors build` writes it, and keeps it when it builds
    again; `noise` prints it for the scene. Default: not stated."""
    x_mm: Length | None = None
    """On a plate, with `y_mm` and instead of `position_mm`: place of the sensor along `x`. `noise` prints
    it, too."""
    y_mm: Length | None = None
    """On a plate: place of the sensor along `y`."""
    register_: Annotated[int | None, Field(alias="register", ge=0, le=65_535)] = None
    """Modbus: address of the first register, from 0. Serial: index in the frame, from 0."""
    input: Annotated[int, Field(ge=0, le=63)] | None = None
    """Number of the input, from 0, instead of `register`; only if the source names its module."""
    unit: Annotated[int, Field(ge=0, le=255)] | None = None
    """Modbus: unit of this channel; default: the source's."""
    host: Host | None = None
    """Modbus TCP: device of this channel; default: the source's."""
    type: ValueType | None = None
    """Modbus: data type of the counts; default: the module's, or u16. Those of f32 and f64 are fractional numbers, for
    example in mm, V or mA."""
    value_unit: Unit = MM
    """Unit of what the sensor shows, as "uV/V", "counts" or "uT". If it is not mm, a value takes the place of the gap:
    deflection = value - value at rest. All keys in `_mm` of the channel are in it, and so are those of the surface, and
    `_um` is a thousandth of it; the channels of a surface have one unit. Default: mm, a gap."""
    gain_mm_per_count: Annotated[Length, AfterValidator(_not_flat)] | None = None
    """gap = offset + gain x counts."""
    offset_mm: Length | None = None
    """Gap at 0 counts."""
    table: Annotated[tuple[Point, ...], Field(strict=False)] | None = None
    """[counts, gap] points instead of gain and offset, joined by straight lines; out-of-range beyond the ends."""
    rest_gap_mm: Length
    """Gap with nothing on the beam; the tare file overrides it."""
    smallest_force_mm: Positive | None = None
    """Deflection here under the model's smallest force, where it moves this sensor most. `tare` refuses a rest gap that
    differs by a tenth of it. Default: a load shows only beyond a part of `range_mm`."""
    range_mm: Range
    """Linear range of the sensor; gaps outside it are out-of-range."""
    adc_bits: Annotated[int, Field(ge=1, le=32)] | None = None
    """Counts of about 0, as without a cable, and of 2**adc_bits - 1 are saturated. Default: the ends of `type` are, and
    f32 and f64 have none; serial: 16."""
    counts_range: Counts | None = None
    """Counts at these ends and beyond are saturated; overrides `adc_bits`."""
    stuck_after_ms: Duration | None = None
    """A channel is stuck when its counts have not changed for longer; default: from the surface's `noise_mm`."""

    @property
    def place_mm(self) -> dict[str, float]:
        """Axis -> its coordinate, as far as it is stated."""
        stated = {"position": self.position_mm, "x": self.x_mm, "y": self.y_mm}
        return {axis: at_mm for axis, at_mm in stated.items() if at_mm is not None}

    @model_validator(mode="after")
    def _ranges_in_order(self) -> Self:
        for name, ends in (("range_mm", self.range_mm), ("counts_range", self.counts_range)):
            if ends is not None and not ends[0] < ends[1]:
                raise ValueError(f"{name} must be [smaller, larger], not [{ends[0]}, {ends[1]}]")
        return self

    @model_validator(mode="after")
    def _one_characteristic(self) -> Self:
        line = {"gain_mm_per_count": self.gain_mm_per_count, "offset_mm": self.offset_mm}
        missing = [key for key, value in line.items() if value is None]
        if self.table is not None and len(missing) < len(line):
            raise ValueError("give a table, or gain_mm_per_count with offset_mm, not both")
        if self.table is None and missing:
            raise ValueError(f"{' and '.join(missing)} missing; give gain_mm_per_count with offset_mm, or a table")
        if self.table is not None:
            _check_table(self.table, self.value_unit)
        return self

    @property
    def points(self) -> tuple[tuple[float, float], ...]:
        """Counts and gap [mm] at the beginning of each piece of the characteristic."""
        return self.table or ((0.0, self.offset_mm or 0.0),)

    @property
    def slopes(self) -> tuple[float, ...]:
        """Slope of each piece [mm per count]; the last piece of a table continues beyond its end."""
        if self.table is None:
            return (self.gain_mm_per_count or math.nan,)
        inner = tuple((b[1] - a[1]) / (b[0] - a[0]) for a, b in pairwise(self.table))
        return (*inner, inner[-1])

    def count_at(self, gap_mm: float) -> float:
        """Return the counts that stand for a gap [mm]; beyond the ends of a table its end pieces continue."""
        pieces = list(zip(self.points, self.slopes, strict=True))
        is_rising = pieces[0][1] > 0
        begun = [piece for piece in pieces if piece[0][1] == gap_mm or (piece[0][1] < gap_mm) == is_rising]
        (count, begin_mm), slope = (begun or pieces[:1])[-1]
        return count + (gap_mm - begin_mm) / slope

    @property
    def linear_counts(self) -> tuple[float, float]:
        """The counts at the ends of the linear range, the smaller first."""
        first, second = map(self.count_at, self.range_mm)
        return min(first, second), max(first, second)

    def saturated_at(self, value_type: ValueType) -> tuple[float, float]:
        """Return the counts at which, and beyond which, the channel is saturated; its counts have this type."""
        if self.counts_range is not None:
            return self.counts_range
        low, high = value_types.ends_of(value_type) if self.adc_bits is None else (0.0, 2.0**self.adc_bits - 1)
        if self._shows_cuts(is_end=low == 0):
            size, is_above = self._most_of_cuts(value_type), low == 0 or self.count_at(self.rest_gap_mm) > 0
            return (size, high) if is_above else (low, -size)
        return low, high

    def _shows_cuts(self, *, is_end: bool) -> bool:
        """Return whether counts of about 0 come from an input without its cable; `is_end`: whether counts end there.

        Else 0 is in the middle of the linear range, or beside it, and may be any gap. At rest it always may.
        """
        first, last = self.linear_counts
        near = NEAR_END * (last - first)
        return (is_end or min(abs(first), abs(last)) <= near) and abs(self.count_at(self.rest_gap_mm)) > near

    def _most_of_cuts(self, value_type: ValueType) -> float:
        """Return the largest count, without its sign, of an input without its cable."""
        largest = max(map(abs, self.linear_counts))
        counts = 0.0 if value_types.has_fractions(value_type) else min(CUT_COUNTS, CUT_PARTS[1] * largest)
        return max(counts, CUT_PARTS[0] * largest)


def _check_table(table: tuple[tuple[float, float], ...], unit: str) -> None:
    if len(table) < 2:
        raise ValueError(f"table needs at least 2 points [counts, gap_mm], not {len(table)}")
    for before, after in pairwise(table):
        if not before[0] < after[0]:
            raise ValueError(f"table: counts must increase, but {after[0]:g} follows {before[0]:g}")
        if after[1] == before[1] or (after[1] > before[1]) != (table[1][1] > table[0][1]):
            message = (
                f"table: gaps must all increase or all decrease, but {after[1]:g} {unit} follows {before[1]:g} {unit}"
            )
            raise ValueError(message)
        if not SMALLEST_SLOPE <= abs(after[1] - before[1]) / (after[0] - before[0]) <= LARGEST:
            span = f"from {before[0]:g} to {after[0]:g} counts"
            raise ValueError(
                f"table: the slope {span} is not within {SMALLEST_SLOPE:g} to {LARGEST:g} {unit} per count"
            )
