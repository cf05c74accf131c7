"""The metadata of a model file: everything that is needed to run its graph."""

import json
from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, PositiveFloat, ValidationError, model_validator

from beamtouch_models.errors import ModelFileError

SCHEMA_VERSION: Literal[2] = 2
METADATA_PREFIX = "beamtouch."
THIS_FILE = "MODEL.onnx"
"""Stands for the name of the file in a message; the loader knows the name."""
INPUTS = ("deflection_mm", "whitening_per_mm")
POSITION_OUTPUTS = ("position_mm", "position_low_mm", "position_high_mm", "contact_log_odds", "misfit")
FORCE_OUTPUTS = ("force_n", "force_low_n", "force_high_n")

_NAME = r"^[A-Za-z0-9_.-]{1,64}$"
_Deviation = Annotated[float, Field(ge=0, allow_inf_nan=False)]
_Pair = Annotated[tuple[FiniteFloat, FiniteFloat], Field(strict=False)]
_PositivePair = Annotated[tuple[PositiveFloat, PositiveFloat], Field(strict=False)]
_GainError = Annotated[float, Field(ge=0, le=1)]
_Threshold = Annotated[float, Field(ge=1, le=1e6)]
"""Rest exceeds 1 in most samples, whatever the scene allows."""
MAX_FALSE = 0.01
"""Largest share of samples at rest that may be taken for a contact; above it, nothing tells a contact from rest."""
SECONDS_PER_DAY = 86_400
MAX_ERROR = 1e3
"""Largest error of a sample, noise or zero, over the largest deflection; a sample carries no information then."""


def most_false_per_day(rate_hz: float) -> float:
    """Return the largest number of false contacts per day that a threshold can be chosen for."""
    return MAX_FALSE * SECONDS_PER_DAY * rate_hz


class _Strict(BaseModel):
    model_config = ConfigDict(
        extra="forbid", strict=True, frozen=True, validate_by_name=True, validate_by_alias=True, serialize_by_alias=True
    )


class Channel(_Strict):
    """One sensor of the layout."""

    name: str = Field(pattern=_NAME)
    position_mm: FiniteFloat
    """From the left end of the beam."""


class Ranges(_Strict):
    """The ranges that the model was made for; outside them its answers mean nothing."""

    position_mm: _Pair
    force_n: _PositivePair
    """Equal if the force is known."""


class Noise(_Strict):
    """Standard deviations in mm."""

    reading_mm: _Deviation
    sample_mm: _Deviation
    """After the filter; the model is made for this noise."""


class Floor(_Strict):
    """Errors that calibration leaves and that never average away: standard deviations per channel."""

    gain: list[_GainError]
    """Relative error of the gain."""
    zero_mm: list[_Deviation]
    """Error of the zero."""


class Thresholds(_Strict):
    """Thresholds for any covariance, by the number of valid channels; the first entries are for one channel."""

    touch: list[_Threshold]
    """A sample is a contact if `contact_log_odds` exceeds this."""
    rest: list[_Threshold]
    """Rest does not explain a sample if the sum of squares of the whitened sample exceeds this."""
    misfit: list[_Threshold]
    """No single contact explains a sample if `misfit` exceeds this."""
    false_contacts_per_day: PositiveFloat
    """Contacts per day at rest that `touch` was chosen for."""


class DrawnSupport(_Strict):
    """A support of the beam, as a page draws it."""

    at_mm: FiniteFloat
    kind: Literal["simple", "fixed"]


class Drawn(_Strict):
    """The beam as a page draws it."""

    supports: list[DrawnSupport]
    """From left to right."""
    at_mm: Annotated[list[FiniteFloat], Field(min_length=2)]
    """Positions along the beam at which the deflection is given, ascending."""
    load_mm: Annotated[list[FiniteFloat], Field(min_length=1)]
    """Positions of the contact for which it is given."""
    deflection_mm_per_n: list[list[FiniteFloat]]
    """For each position of the contact, the deflection along the beam."""

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        rows = [len(row) for row in self.deflection_mm_per_n]
        if rows != [len(self.at_mm)] * len(self.load_mm):
            message = f"deflection_mm_per_n must hold {len(self.load_mm)} rows of {len(self.at_mm)} values"
            raise ValueError(message)
        if any(list(values) != sorted(set(values)) for values in (self.at_mm, self.load_mm)):
            message = "at_mm and load_mm must ascend"
            raise ValueError(message)
        return self


class Influence(_Strict):
    """The influence at the sensors, as the estimator knows it: with gains and positions of a calibration."""

    mm_per_n: list[list[FiniteFloat]] = Field(min_length=4)
    """For evenly spaced positions of the contact from end to end of the range, the deflection at each sensor."""


class Seen(_Strict):
    """The smallest force that a settled sample shows along the beam, with all channels."""

    position_mm: Annotated[list[FiniteFloat], Field(min_length=1)]
    force_n: list[PositiveFloat]
    """Of 100 settled samples at this force, 95 are a contact."""

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if len(self.force_n) != len(self.position_mm):
            message = f"{len(self.position_mm)} positions with {len(self.force_n)} forces"
            raise ValueError(message)
        return self


class FilterChoice(_Strict):
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
    def most(self) -> int:
        """Largest number of readings in a sample."""
        return self.longest or self.window


class Sensor(_Strict):
    """The sensor and ADC of every channel."""

    rate_hz: PositiveFloat
    range_mm: _PositivePair
    standoff_mm: PositiveFloat
    """Gap at rest."""
    adc_bits: int = Field(ge=6, le=16)
    gain_mm_per_count: FiniteFloat
    offset_mm: FiniteFloat
    """Nominal characteristic: gap in mm = offset + gain x counts."""


class Accuracy(_Strict):
    """Mean |position error| in percent of the length (eq. 5 of the paper), over the scene's ranges."""

    error_percent: float
    error_standard_error: float
    limit_percent: float
    limit_standard_error: float
    ratio_standard_error: float
    """Standard error of `ratio`, whose terms share their contacts."""

    @property
    def ratio(self) -> float:
        """Error over the accuracy limit; no estimator gets below 1."""
        return self.error_percent / self.limit_percent if self.limit_percent else float("nan")


class Departures(_Strict):
    """Differences of a real surface from its scene, fitted by a calibration. Lists have an entry per channel."""

    position_offset_mm: list[FiniteFloat]
    """True position of each sensor minus its position in the layout."""
    gain: list[PositiveFloat]
    """Measured over true deflection."""
    offset_mm: list[FiniteFloat]
    """Measured deflection at rest."""
    curve_per_mm: FiniteFloat = 0.0
    """Curvature of the characteristic: y + curve y^2 is proportional to the deflection; y is measured minus offset."""
    fixity: _Pair = (0.0, 0.0)
    """Fixity of the leftmost and the rightmost support."""
    rigidity: PositiveFloat = 1.0
    """Factor on E I."""


class Calibration(_Strict):
    """A fit to recorded loads, to unlabelled contacts, or to the ones and then to the others."""

    departures: Departures
    fitted: list[str]
    """Kinds of departures that were fitted; the others are as in the scene."""
    loads: int = Field(ge=0)
    residual_mm: float = Field(ge=0, alias="unexplained_mm")
    """Standard deviation that a fit leaves in the deflections of a left-out load, beyond noise; part of the noise."""
    error_before_mm: float | None = None
    """Mean position error of the loads; None without loads."""
    error_after_mm: float | None = None
    """Mean position error of the loads, each by a fit without it."""
    contacts: int = Field(default=0, ge=0)
    """Number of unlabelled contacts."""
    misfit_before: float | None = None
    """Median misfit of the contacts, without the floor; None without contacts."""
    misfit_after: float | None = None
    """The same, each by a fit without it."""
    force_error: _Deviation = 0.0
    """Relative error of all forces together, which unlabelled contacts leave; part of the intervals of the force."""


class Golden(_Strict):
    """Inputs with the answers that the graph gave when it was built."""

    deflection_mm: list[list[FiniteFloat]] = Field(min_length=1)
    whitening_per_mm: list[list[list[FiniteFloat]]] = Field(min_length=1)
    answers: dict[str, list[FiniteFloat]]


class Metadata(_Strict):
    """The metadata of a model file: each field is one entry, as JSON, named `beamtouch.<field>`."""

    schema_version: Literal[2] = SCHEMA_VERSION
    name: str = Field(pattern=_NAME)
    """Name of the scene, and of the surface unless a configuration gives another."""
    estimator: str
    length_mm: PositiveFloat
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
    smallest_force: Seen
    drawn: Drawn
    influence: Influence | None = None
    """None in older files: without it, nothing is known of how the sensors change."""
    seed: int
    accuracy: Accuracy
    calibration: Calibration | None = None
    """None if the model was made from the scene alone."""
    golden: Golden
    scene: str
    """TOML text of the scene, so that the model can be rebuilt from its own file."""

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        names = [channel.name for channel in self.layout]
        if len(set(names)) != len(names):
            message = "layout: two channels have the same name"
            raise ValueError(message)
        if self.min_channels > len(names):
            message = f"min_channels: {self.min_channels} of {len(names)} channels"
            raise ValueError(message)
        golden = self.golden
        rows: list[list[float]] = [*golden.deflection_mm, *(row for one in golden.whitening_per_mm for row in one)]
        if any(len(row) != len(names) for row in rows) or len(rows) != len(golden.deflection_mm) * (len(names) + 1):
            message = f"golden: every row of inputs must have {len(names)} channels"
            raise ValueError(message)
        limits = self.thresholds
        each: list[list[Any]] = [limits.touch, limits.rest, limits.misfit, self.floor.gain, self.floor.zero_mm]
        if any(len(values) != len(names) for values in each):
            message = f"thresholds and floor: each list must have {len(names)} entries"
            raise ValueError(message)
        if self.influence and any(len(row) != len(names) for row in self.influence.mm_per_n):
            message = f"influence: every row must have {len(names)} channels"
            raise ValueError(message)
        found = self.calibration.departures if self.calibration else None
        if found and any(
            len(values) != len(names) for values in (found.position_offset_mm, found.gain, found.offset_mm)
        ):
            message = f"calibration.departures: each list must have {len(names)} entries"
            raise ValueError(message)
        return self

    @model_validator(mode="after")
    def _within_the_beam(self) -> Self:
        ranges, drawn, seen = self.ranges, self.drawn, self.smallest_force
        for name, values in (("position_mm", ranges.position_mm), ("force_n", ranges.force_n)):
            if values[0] > values[1]:
                message = f"ranges.{name}: the first must not exceed the second"
                raise ValueError(message)
        placed = {
            "layout": [channel.position_mm for channel in self.layout],
            "ranges.position_mm": list(ranges.position_mm),
            "drawn": [*(support.at_mm for support in drawn.supports), *drawn.at_mm, *drawn.load_mm],
            "smallest_force": seen.position_mm,
        }
        for name, positions in placed.items():
            if not all(0 <= position <= self.length_mm for position in positions):
                message = f"{name}: every position must lie on the beam, 0..{self.length_mm:g} mm"
                raise ValueError(message)
        return self

    @model_validator(mode="after")
    def _within_reason(self) -> Self:
        if self.thresholds.false_contacts_per_day > (most := most_false_per_day(self.sensor.rate_hz)):
            message = f"thresholds.false_contacts_per_day: at {self.sensor.rate_hz:g} Hz at most {most:.6g}"
            raise ValueError(message)
        if min(self.noise.reading_mm, self.noise.sample_mm) == 0:
            message = "noise: without noise there are no intervals"
            raise ValueError(message)
        errors = {"noise": [self.noise.reading_mm, self.noise.sample_mm], "floor.zero_mm": self.floor.zero_mm}
        for name, values_mm in errors.items():
            if max(values_mm) > MAX_ERROR * self.max_deflection_mm:
                message = f"{name} hides the largest deflection, {self.max_deflection_mm:.3g} mm"
                raise ValueError(message)
        return self

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
            message = "it is an ONNX file but not a Beamtouch model: it has no beamtouch metadata"
            raise ModelFileError(message)
        if ours.get("schema_version") == "1":
            raise _old("schema version 1, from before samples stated their covariance")
        try:
            values = {key: json.loads(text) for key, text in ours.items()}
        except (ValueError, RecursionError):
            # These include numbers and nesting beyond what the parser takes.
            message = "its metadata is not JSON"
            raise ModelFileError(message) from None
        if _lacks_thresholds(values.get("thresholds")):
            raise _old("from before one channel and two had a threshold of their own")
        try:
            return cls.model_validate(values)
        except ValidationError as error:
            first = error.errors()[0]
            where = ".".join(str(part) for part in first["loc"])
            reason = first["msg"].removeprefix("Value error, ")
            message = f"metadata entry {METADATA_PREFIX}{where}: {reason}" if where else f"metadata: {reason}"
            raise ModelFileError(message) from None


def _lacks_thresholds(found: object) -> bool:
    """Return whether some number of channels has no threshold, as earlier versions of `build` wrote it."""
    lists = found.values() if isinstance(found, dict) else []
    return any(isinstance(values, list) and None in values for values in lists)


def _old(why: str) -> ModelFileError:
    message = (
        f"{why}; rebuild it from its own scene with `design-sensors build {THIS_FILE} -o {THIS_FILE}`, "
        "and calibrate it again if it was calibrated"
    )
    return ModelFileError(message)
