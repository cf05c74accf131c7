"""The metadata of a model file: everything that is needed to run its graph. `Metadata` has the whole."""

import json
import math
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    FiniteFloat,
    NonNegativeFloat,
    PositiveFloat,
    ValidationError,
    model_validator,
)

from beamtouch_common.complaints import reason_of
from beamtouch_common.digits import rounded
from beamtouch_common.names import Name
from beamtouch_common.outline import BEAM_AXIS, Outline, names_of
from beamtouch_common.units import MM, Unit
from beamtouch_models.arrays import Floats
from beamtouch_models.errors import ModelFileError
from beamtouch_models.names import Criterion
from beamtouch_models.places import Extent

Deviation = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Pair = Annotated[tuple[FiniteFloat, FiniteFloat], Field(strict=False)]
Axis = Annotated[str, Field(pattern=r"^[a-z][a-z0-9]{0,15}$")]
"""Name of an axis, which begins the names of its figures."""
PositivePair = Annotated[tuple[PositiveFloat, PositiveFloat], Field(strict=False)]

INPUTS = ("deflection_mm", "whitening_per_mm")
EVIDENCE_OUTPUTS = ("contact_log_odds", "misfit")


POSITION_OUTPUTS = (*names_of(BEAM_AXIS, "mm"), *EVIDENCE_OUTPUTS)
"""Outputs of a beam."""
FORCE_OUTPUTS = names_of("force", "n")
CORRELATION_OUTPUT = "place_correlation"
"""Output of two axes: the correlation of the two coordinates, -1 to 1, which makes an ellipse of their intervals."""
SCHEMA_VERSION: Literal[5] = 5
METADATA_PREFIX = "beamtouch."
THIS_FILE = "MODEL.onnx"
"""Stands for the name of the file in a message; the loader knows the name."""


def _is_none(value: object) -> bool:
    return value is None


def fewest_that_check(axes: int) -> int:
    """Return the smallest number of channels that check a contact on a structure of so many axes.

    As many channels as a contact has coordinates, and one more, fit one of an open force to any sample but a pull and
    the like: two on a beam, three on a plate. A known force is little to check these by.
    """
    return axes + 2


class MetadataPart(BaseModel):
    """A part of the metadata. It is immutable, and unknown fields are refused."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)

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
    across_mm: FiniteFloat | None = Field(default=None, exclude_if=_is_none)
    """Along the second axis; only on a plate."""
    unit: Annotated[Unit, Field(exclude_if=_is_mm)] = MM
    """Unit of its deflection. All figures of deflections, in `_mm` by their names, are in it."""


class Ranges(MetadataPart):
    """The ranges that the model was made for; outside them its answers mean nothing."""

    position_mm: Pair
    """On a plate, along its first axis."""
    across_mm: Pair | None = Field(default=None, exclude_if=_is_none)
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
    across_mm: FiniteFloat | None = Field(default=None, exclude_if=_is_none)
    """Along the second axis; only on a plate."""
    end_mm: Pair | None = Field(default=None, exclude_if=_is_none)
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
    across_mm: list[FiniteFloat] | None = Field(default=None, exclude_if=_is_none)
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


class Departures(MetadataPart):
    """Differences of a real surface from its scene. Lists have an entry per channel.

    A true deflection w is measured as y + offset, where y + curve y^2 = gain w.
    """

    position_offset_mm: list[FiniteFloat]
    """True position of each sensor minus its position in the layout."""
    gain: list[PositiveFloat]
    """Measured over true deflection."""
    offset_mm: list[FiniteFloat]
    """Measured deflection at rest; a tare removes it."""
    curve_per_mm: FiniteFloat = 0.0
    """Curvature of the characteristic."""
    fixity: Pair = (0.0, 0.0)
    """Fixity of the leftmost and the rightmost support."""
    rigidity: PositiveFloat = 1.0
    """Factor on E I, or on a plate and all its springs. Where known loads show only its product with all gains, it
    holds what the gains have in common."""
    across_offset_mm: list[FiniteFloat] | None = Field(default=None, exclude_if=_is_none)
    """True place of each sensor minus that in the layout, along the second axis; only on a plate."""
    spring_stiffness: list[PositiveFloat] | None = Field(default=None, exclude_if=_is_none)
    """Factor on the spring in each support of a plate, beside that on all of them; 1 for a rigid support."""

    @classmethod
    def none(cls, channels: int) -> "Departures":
        """Return those of a surface that is as its scene says."""
        return cls(position_offset_mm=[0.0] * channels, gain=[1.0] * channels, offset_mm=[0.0] * channels)

    @property
    def offsets_mm(self) -> Floats:
        """Offsets of the sensors as their positions are stated: (channels,), on a plate (channels, 2)."""
        if self.across_offset_mm is None:
            return np.array(self.position_offset_mm)
        return np.column_stack([self.position_offset_mm, self.across_offset_mm])

    def sensors_mm(self, layout_mm: Floats, size_mm: tuple[float, ...]) -> Floats:
        """Return the true positions (channels,) of the sensors of a layout on a beam of this length.

        On a plate of this size, they are places (channels, 2).
        """
        if layout_mm.ndim > 1 and self.across_offset_mm is None:
            return layout_mm
        true_mm: Floats = np.clip(layout_mm + self.offsets_mm, 0.0, size_mm if layout_mm.ndim > 1 else size_mm[0])
        return true_mm

    def measure(self, linear_mm: Floats) -> Floats:
        """Return what the sensors measure (..., channels) of deflections that hold the gains, gain w, in mm."""
        # The root of y + curve y^2 = linear that is 0 at 0, in the form that does not cancel.
        square = np.maximum(1 + 4 * self.curve_per_mm * linear_mm, 0.0)
        measured: Floats = 2 * linear_mm / (1 + np.sqrt(square)) + np.array(self.offset_mm)
        return measured

    def slope(self, linear_mm: Floats) -> Floats:
        """Return the change of `measure` with the deflection that it is given."""
        slope: Floats = 1 / np.sqrt(np.maximum(1 + 4 * self.curve_per_mm * linear_mm, np.finfo(np.float64).tiny))
        return slope

    def linear_mm(self, measured_mm: Floats) -> Floats:
        """Return the deflections that hold the gains (..., channels) of measured ones: the inverse of `measure`."""
        return self.straighten(measured_mm - np.array(self.offset_mm))

    def straighten(self, from_rest_mm: Floats) -> Floats:
        """Return the deflections that hold the gains (..., channels) of measured ones less those at rest."""
        linear: Floats = from_rest_mm + self.curve_per_mm * from_rest_mm**2
        return linear


class Calibration(MetadataPart):
    """A fit to recorded loads, to unlabelled contacts, or to the ones and then to the others."""

    departures: Departures
    fitted: list[str]
    """Kinds of departures that were fitted; the others are as in the scene."""
    loads: int = Field(ge=0)
    residual_mm: float = Field(ge=0)
    """Standard deviation that a fit leaves in the deflections of a left-out load, beyond noise; the floor holds it."""
    error_before_mm: float | None = None
    """Mean position error of the loads; None without loads."""
    error_after_mm: float | None = None
    """Mean position error of the loads, each by a fit without it."""
    contacts: int = Field(default=0, ge=0)
    """Number of unlabelled contacts."""
    misfit_before: float | None = None
    """Median misfit of the contacts, without the floor; None without contacts."""
    misfit_after: float | None = None
    """The same by the fit."""
    force_error: Deviation = 0.0
    """Relative error of all forces together, which loads or contacts leave; part of the intervals of the force."""


class Metadata(MetadataPart):
    """The metadata of a model file: each field is one entry, as JSON, named `beamtouch.<field>`."""

    schema_version: Literal[5] = SCHEMA_VERSION
    name: Name
    """Name of the scene, and of the surface unless a configuration gives another."""
    beam: Name
    """Identity of the beam with its layout: the same for every model of it, calibrated or not."""
    estimator: str
    length_mm: PositiveFloat
    """Length of the first axis."""
    axes: Annotated[list[Axis], Field(min_length=1, max_length=2)] = [BEAM_AXIS]
    """Names of the axes of a place. An output of place is named after its axis, as `position_mm` or `x_low_mm`."""
    width_mm: PositiveFloat | None = None
    """Length of the second axis; None on a beam."""
    layout: Annotated[list[Channel], Field(min_length=1)]
    """In input order."""
    min_channels: int = Field(ge=1)
    """Smallest number of working channels with which the model gives a position."""
    ranges: Ranges
    max_deflection_mm: PositiveFloat
    """Largest deflection in the scene, anywhere on the beam, at the largest force."""
    noise: Noise
    floor: Floor
    filter: FilterChoice
    sensor: Sensor
    thresholds: Thresholds
    """Unused if the graph gives neither log odds nor a misfit."""
    smallest_force: SmallestForce
    drawn: BeamDrawing
    influence: Influence
    placed: LayoutErrors
    seed: int
    accuracy: Accuracy
    calibration: Calibration | None = None
    """None if the model was made from the scene alone."""
    golden: Golden = Field(repr=False)
    scene: str = Field(repr=False)
    """TOML text of the scene, so that the model can be rebuilt from its own file."""

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        names = [channel.name for channel in self.layout]
        if len(set(names)) != len(names):
            raise ValueError("layout: two channels have the same name")
        if len(units := {channel.unit for channel in self.layout}) > 1:
            raise ValueError(f"layout: channels with different units, {' and '.join(sorted(units))}")
        if self.min_channels > len(names):
            raise ValueError(f"min_channels: {self.min_channels} of {len(names)} channels")
        if len(set(self.axes)) != len(self.axes) or len(self.axes) != (1 if self.width_mm is None else 2):
            raise ValueError(f"axes: {', '.join(self.axes)}, with width_mm = {self.width_mm}; only two axes have one")
        across = [self.ranges.across_mm, *(channel.across_mm for channel in self.layout)]
        if any((one is None) == (len(self.axes) > 1) for one in across):
            raise ValueError("across_mm: layout and ranges have it on two axes, and only there")
        golden, limits = self.golden, self.thresholds
        without, uncertain = self.placed.limit_without_percent, self.placed.limit_without_standard_error
        departures = self.calibration.departures if self.calibration else None
        lists: dict[str, list[list[Any]]] = {
            "thresholds and floor": [limits.touch, limits.rest, limits.misfit, self.floor.gain, self.floor.zero_mm],
            "placed": [without, uncertain] if without or uncertain else [],
            "influence": [*self.influence.mm_per_n],
            "golden": [*golden.deflection_mm, *(row for whitening in golden.whitening_per_mm for row in whitening)],
            "calibration.departures": [
                departures.position_offset_mm,
                *([] if departures.across_offset_mm is None else [departures.across_offset_mm]),
                departures.gain,
                departures.offset_mm,
            ]
            if departures
            else [],
        }
        for where, rows in lists.items():
            if any(len(values) != len(names) for values in rows):
                raise ValueError(f"{where}: each list must have {len(names)} entries")
        if len(lists["golden"]) != len(golden.deflection_mm) * (len(names) + 1):
            raise ValueError(f"golden: each input must have {len(names)} channels")
        return self

    @property
    def layout_mm(self) -> Floats:
        """Positions of the sensors (channels,) in mm from the left end, in input order; on a plate (channels, 2)."""
        if len(self.axes) == 1:
            return np.array([channel.position_mm for channel in self.layout])
        return np.array([[channel.position_mm, channel.across_mm] for channel in self.layout], dtype=np.float64)

    def place_of(self, channel: Channel) -> dict[str, float]:
        """Return the place of a sensor: axis -> its coordinate [mm]."""
        place_mm = (channel.position_mm, *([] if channel.across_mm is None else [channel.across_mm]))
        return dict(zip(self.axes, place_mm, strict=True))

    @property
    def size_mm(self) -> tuple[float, ...]:
        """Length along each axis."""
        return (self.length_mm,) if self.width_mm is None else (self.length_mm, self.width_mm)

    @property
    def diagonal_mm(self) -> float:
        """Length of which errors are a percentage: that of a beam, the diagonal of a plate."""
        return math.hypot(*self.size_mm)

    @property
    def extent(self) -> Extent:
        """The places that contacts may have."""
        across_mm = self.ranges.across_mm
        return Extent((self.ranges.position_mm,) if across_mm is None else (self.ranges.position_mm, across_mm))

    @property
    def unit(self) -> str:
        """Unit of all deflections."""
        return self.layout[0].unit

    @property
    def outline(self) -> Outline:
        """The axes with their lengths."""
        return Outline(dict(zip(self.axes, self.size_mm, strict=True)))

    @property
    def departures(self) -> Departures:
        """The departures that a calibration found; without one, none."""
        return self.calibration.departures if self.calibration else Departures.none(len(self.layout))

    def to_entries(self) -> dict[str, str]:
        """Return the ONNX metadata entries, key to JSON text."""
        fields = self.model_dump(mode="json")
        return {METADATA_PREFIX + key: json.dumps(value, sort_keys=True) for key, value in fields.items()}

    @classmethod
    def from_entries(cls, entries: dict[str, str]) -> "Metadata":
        """Read the ONNX metadata entries; raises ModelFileError naming the first entry that is wrong."""
        ours = {
            key.removeprefix(METADATA_PREFIX): text for key, text in entries.items() if key.startswith(METADATA_PREFIX)
        }
        if not ours:
            raise ModelFileError("it is an ONNX file but not a Beamtouch model: it has no beamtouch metadata")
        if (version := ours.get("schema_version", "0")) != str(SCHEMA_VERSION):
            raise ModelFileError(
                f"metadata entry {METADATA_PREFIX}schema_version: {version[:20]!r}, but this version reads "
                f"{SCHEMA_VERSION}; rebuild it from its own scene with `design-sensors build {THIS_FILE} -o "
                f"{THIS_FILE}`, and calibrate it again if it was calibrated"
            )
        try:
            values = {key: json.loads(text) for key, text in ours.items()}
        except (ValueError, RecursionError):
            # These include numbers and nesting beyond what the parser takes.
            raise ModelFileError("its metadata is not JSON") from None
        try:
            return cls.model_validate(values)
        except ValidationError as error:
            first = error.errors()[0]
            where = ".".join(str(part) for part in first["loc"])
            reason = reason_of(first)
            message = f"metadata entry {METADATA_PREFIX}{where}: {reason}" if where else f"metadata: {reason}"
            raise ModelFileError(message) from None
