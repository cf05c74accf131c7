"""All metadata of a model file, as the entries of an ONNX file."""

import json
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, PositiveFloat, ValidationError, model_validator

from beamtouch_common.complaints import reason_of
from beamtouch_common.digits import digits
from beamtouch_models.arrays import Floats
from beamtouch_models.errors import ModelFileError
from beamtouch_models.metadata.calibration import Calibration, Departures
from beamtouch_models.metadata.fields import NAME, MetadataPart
from beamtouch_models.metadata.figures import (
    Accuracy,
    Golden,
    LayoutErrors,
    SmallestForce,
    Thresholds,
)
from beamtouch_models.metadata.surface import Channel, Drawn, FilterChoice, Floor, Influence, Noise, Ranges, Sensor
from beamtouch_models.rates import max_false_per_day

SCHEMA_VERSION: Literal[4] = 4
METADATA_PREFIX = "beamtouch."
THIS_FILE = "MODEL.onnx"
"""Stands for the name of the file in a message; the loader knows the name."""
MAX_ERROR = 1e3
"""Largest error of a sample, noise or zero, over the largest deflection; a sample carries no information then."""


class Metadata(MetadataPart):
    """The metadata of a model file: each field is one entry, as JSON, named `beamtouch.<field>`."""

    schema_version: Literal[4] = SCHEMA_VERSION
    name: str = Field(pattern=NAME)
    """Name of the scene, and of the surface unless a configuration gives another."""
    beam: str = Field(pattern=NAME)
    """Identity of the beam with its layout: the same for every model of it, calibrated or not."""
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
    smallest_force: SmallestForce
    drawn: Drawn
    influence: Influence
    placed: LayoutErrors
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
            raise ValueError("layout: two channels have the same name")
        if self.min_channels > len(names):
            raise ValueError(f"min_channels: {self.min_channels} of {len(names)} channels")
        golden, limits, placed = self.golden, self.thresholds, self.placed
        found = self.calibration.departures if self.calibration else None
        lists: dict[str, list[list[Any]]] = {
            "thresholds and floor": [limits.touch, limits.rest, limits.misfit, self.floor.gain, self.floor.zero_mm],
            "placed": [one for one in (placed.limit_without_percent, placed.limit_without_standard_error) if one],
            "influence": [*self.influence.mm_per_n],
            "golden": [*golden.deflection_mm, *(row for one in golden.whitening_per_mm for row in one)],
            "calibration.departures": [found.position_offset_mm, found.gain, found.offset_mm] if found else [],
        }
        for where, each in lists.items():
            if any(len(values) != len(names) for values in each):
                raise ValueError(f"{where}: each list must have {len(names)} entries")
        if len(lists["golden"]) != len(golden.deflection_mm) * (len(names) + 1):
            raise ValueError(f"golden: each input must have {len(names)} channels")
        return self

    @model_validator(mode="after")
    def _within_the_beam(self) -> Self:
        ranges, drawn, seen = self.ranges, self.drawn, self.smallest_force
        for name, values in (("position_mm", ranges.position_mm), ("force_n", ranges.force_n)):
            if values[0] > values[1]:
                raise ValueError(f"ranges.{name}: the first must not exceed the second")
        placed = {
            "layout": [channel.position_mm for channel in self.layout],
            "ranges.position_mm": list(ranges.position_mm),
            "drawn": [*(support.at_mm for support in drawn.supports), *drawn.at_mm, *drawn.load_mm],
            "smallest_force": seen.position_mm,
        }
        for name, positions in placed.items():
            if not all(0 <= position <= self.length_mm for position in positions):
                raise ValueError(f"{name}: every position must lie on the beam, 0..{self.length_mm:g} mm")
        return self

    @model_validator(mode="after")
    def _within_reason(self) -> Self:
        if self.thresholds.false_contacts_per_day > (most := max_false_per_day(self.sensor.rate_hz)):
            message = f"thresholds.false_contacts_per_day: at {self.sensor.rate_hz:g} Hz at most {digits(most, 6)}"
            raise ValueError(message)
        if min(self.noise.reading_mm, self.noise.sample_mm) == 0:
            raise ValueError("noise: without noise there are no intervals")
        errors = {"noise": [self.noise.reading_mm, self.noise.sample_mm], "floor.zero_mm": self.floor.zero_mm}
        for name, values_mm in errors.items():
            if max(values_mm) > MAX_ERROR * self.max_deflection_mm:
                raise ValueError(f"{name} hides the largest deflection, {digits(self.max_deflection_mm, 3)} mm")
        return self

    @property
    def layout_mm(self) -> Floats:
        """Positions of the sensors (channels,) in mm from the left end, in input order."""
        return np.array([channel.position_mm for channel in self.layout])

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
            message = (
                f"metadata entry {METADATA_PREFIX}schema_version: {version[:20]!r}, but this version reads "
                f"{SCHEMA_VERSION}; rebuild it from its own scene with `design-sensors build {THIS_FILE} -o "
                f"{THIS_FILE}`, and calibrate it again if it was calibrated"
            )
            raise ModelFileError(message)
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
