"""The metadata of a model file: everything that is needed to run its graph."""

import json
from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, PositiveFloat, ValidationError, model_validator

from beamtouch_models.errors import ModelFileError

SCHEMA_VERSION: Literal[1] = 1
METADATA_PREFIX = "beamtouch."
INPUTS = ("deflection_mm", "valid")
POSITION_OUTPUTS = ("position_mm", "position_low_mm", "position_high_mm", "contact_log_odds")
FORCE_OUTPUTS = ("force_n", "force_low_n", "force_high_n")

_NAME = r"^[A-Za-z0-9_.-]{1,64}$"


class _Strict(BaseModel):
    model_config = ConfigDict(
        extra="forbid", frozen=True, validate_by_name=True, validate_by_alias=True, serialize_by_alias=True
    )


class Channel(_Strict):
    """One sensor of the layout."""

    name: str = Field(pattern=_NAME)
    position_mm: FiniteFloat
    """From the left end of the beam."""


class Ranges(_Strict):
    """What the model was made for; outside of it, it knows nothing."""

    position_mm: tuple[FiniteFloat, FiniteFloat]
    force_n: tuple[PositiveFloat, PositiveFloat]
    """Equal ends: the force is known."""


class Noise(_Strict):
    """Standard deviations in mm."""

    reading_mm: float = Field(ge=0)
    sample_mm: float = Field(ge=0)
    """After the filter; what the model was trained with."""


class FilterChoice(_Strict):
    """The filter between reading and sample that the model was made for."""

    kind: Literal["none", "moving-average"] = "none"
    window: int = Field(default=1, ge=1)
    spike_mm: PositiveFloat | None = None
    """A reading further than this from the median of the last three is a spike; null: no spike filter."""
    settling_ms: float = Field(default=0.0, ge=0)
    """From the first reading of a new load to the first sample that knows only that load."""


class Sensor(_Strict):
    """What every channel has in common."""

    rate_hz: PositiveFloat
    range_mm: tuple[PositiveFloat, PositiveFloat]
    standoff_mm: PositiveFloat
    """Gap at rest."""
    adc_bits: int = Field(ge=6, le=16)
    gain_mm_per_count: FiniteFloat
    offset_mm: FiniteFloat
    """gap in mm = offset + gain x counts, the nominal characteristic."""


class Accuracy(_Strict):
    """Mean |position error| in percent of the length (eq. 5 of the paper), over the scene's ranges."""

    error_percent: float
    error_standard_error: float
    limit_percent: float
    limit_standard_error: float
    ratio_standard_error: float | None = None
    """Of the ratio, both on the same contacts; None in a file that does not state it."""

    @property
    def ratio(self) -> float:
        """Error over the accuracy limit; 1 is the best that any estimator can do."""
        return self.error_percent / self.limit_percent if self.limit_percent else float("nan")


class Departures(_Strict):
    """How a real surface differs from its scene: what a calibration fits. Lists have an entry per channel."""

    position_offset_mm: list[FiniteFloat]
    """True position of a sensor less that of the layout."""
    gain: list[PositiveFloat]
    """How many times as large a channel states a deflection."""
    offset_mm: list[FiniteFloat]
    """What a channel states at rest."""
    curve_per_mm: FiniteFloat = 0.0
    """y + curve y^2 is in proportion to the deflection, y being what is stated less the offset."""
    fixity: tuple[FiniteFloat, FiniteFloat] = (0.0, 0.0)
    """Of the leftmost and of the rightmost support."""
    rigidity: PositiveFloat = 1.0
    """Factor on E I."""


class Calibration(_Strict):
    """A fit to recorded loads; errors are means over them, in mm."""

    departures: Departures
    fitted: list[str]
    """Which kinds of departures the loads support; the others are as the scene says."""
    loads: int
    residual_mm: float = Field(ge=0, alias="unexplained_mm")
    """Standard deviation that a fit leaves in the deflections of a left-out load, beyond noise; part of the noise."""
    error_before_mm: float
    error_after_mm: float
    """Each load answered by a model that was fitted without it."""


class Golden(_Strict):
    """Inputs with the answers that the graph gave when it was made."""

    deflection_mm: list[list[FiniteFloat]] = Field(min_length=1)
    valid: list[list[bool]] = Field(min_length=1)
    answers: dict[str, list[FiniteFloat]]


class Metadata(_Strict):
    """Everything the file says of itself; each field is one metadata entry, as JSON, under `beamtouch.<field>`."""

    schema_version: Literal[1] = SCHEMA_VERSION
    name: str = Field(pattern=_NAME)
    """Of the scene; the surface's name unless a config gives another."""
    estimator: str
    length_mm: PositiveFloat
    layout: Annotated[list[Channel], Field(min_length=1)]
    """In input order."""
    min_channels: int = Field(ge=1)
    """With fewer working channels than this the model gives no position."""
    ranges: Ranges
    max_deflection_mm: PositiveFloat
    """The largest in the scene, anywhere on the beam, at the largest force."""
    noise: Noise
    filter: FilterChoice
    sensor: Sensor
    contact_threshold: FiniteFloat
    """Contact is stated when `contact_log_odds` exceeds this; without meaning where the graph gives none."""
    seed: int
    accuracy: Accuracy
    calibration: Calibration | None = None
    """None: the model is that of the scene."""
    golden: Golden
    scene: str
    """The scene's TOML text, so that a model can be rebuilt from itself."""

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        names = [channel.name for channel in self.layout]
        if len(set(names)) != len(names):
            message = "layout: a channel name occurs twice"
            raise ValueError(message)
        if self.min_channels > len(names):
            message = f"min_channels: {self.min_channels} of {len(names)} channels"
            raise ValueError(message)
        rows: list[list[float] | list[bool]] = [*self.golden.deflection_mm, *self.golden.valid]
        if len(self.golden.valid) != len(self.golden.deflection_mm) or any(len(row) != len(names) for row in rows):
            message = f"golden: its inputs are not rows of {len(names)} channels"
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
        try:
            return cls.model_validate({key: json.loads(text) for key, text in ours.items()})
        except ValidationError as error:
            first = error.errors()[0]
            where = ".".join(str(part) for part in first["loc"])
            reason = first["msg"].removeprefix("Value error, ")
            message = f"metadata entry {METADATA_PREFIX}{where}: {reason}" if where else f"metadata: {reason}"
            raise ModelFileError(message) from None
        except (ValueError, RecursionError):
            # Also numbers and nesting beyond what the parser takes.
            message = "its metadata is not JSON"
            raise ModelFileError(message) from None
