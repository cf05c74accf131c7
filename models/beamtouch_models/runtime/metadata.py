"""The metadata of a model file: everything that is needed to run its graph. `Metadata` has the whole."""

import json
import math
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, PositiveFloat, ValidationError, model_validator

from beamtouch_common.complaints import reason_of
from beamtouch_common.names import Name
from beamtouch_common.outline import BEAM_AXIS, Outline, names_of
from beamtouch_models.arrays import Floats
from beamtouch_models.errors import ModelFileError
from beamtouch_models.places import Extent
from beamtouch_models.runtime.departures import Calibration, Departures
from beamtouch_models.runtime.metadata_parts import (
    Accuracy,
    BeamDrawing,
    Channel,
    FilterChoice,
    Floor,
    Golden,
    Influence,
    LayoutErrors,
    MetadataPart,
    Noise,
    Ranges,
    Sensor,
    SmallestForce,
    Thresholds,
)

Axis = Annotated[str, Field(pattern=r"^[a-z][a-z0-9]{0,15}$")]
"""Name of an axis, which begins the names of its figures."""
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


def fewest_that_check(axes: int) -> int:
    """Return the smallest number of channels that check a contact on a structure of so many axes.

    As many channels as a contact has coordinates, and one more, fit one of an open force to any sample but a pull and
    the like: two on a beam, three on a plate. A known force is little to check these by.
    """
    return axes + 2


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
    axes: list[Axis] = Field(default_factory=lambda: [BEAM_AXIS], min_length=1, max_length=2)
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
