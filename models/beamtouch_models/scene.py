"""What the user states about a surface before it is built: a TOML file, checked strictly."""

import tomllib
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, PositiveInt, ValidationError, model_validator

from beamtouch_models.errors import SceneError
from beamtouch_models.physics.structure import Beam, Finite, PositiveFinite, Strict
from beamtouch_models.text_file import read_text

__all__ = ["Beam", "Contact", "Descriptor", "Requirements", "Scene", "Sensors", "load_scene", "parse_scene"]

MIN_SENSORS, MAX_SENSORS = 1, 64


class Contact(Strict):
    """What may touch the beam: a range, drawn from uniformly."""

    force_n: PositiveFinite | tuple[PositiveFinite, PositiveFinite]
    """One number: the weight is known. Two: it lies between them."""
    position_mm: tuple[Finite, Finite]
    width_mm: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 0.0
    """Length of beam that a contact presses on, evenly, centred at its position; 0 is a point."""

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.force_range_n[0] > self.force_range_n[1]:
            message = f"force_n = {list(self.force_range_n)}: the first must not exceed the second"
            raise ValueError(message)
        if self.position_mm[0] >= self.position_mm[1]:
            message = f"position_mm = {list(self.position_mm)}: the first must be less than the second"
            raise ValueError(message)
        return self

    @property
    def force_range_n(self) -> tuple[float, float]:
        """Smallest and largest force, equal where it is known."""
        return self.force_n if isinstance(self.force_n, tuple) else (self.force_n, self.force_n)

    @property
    def force_is_known(self) -> bool:
        """Whether the scene states one force."""
        return self.force_range_n[0] == self.force_range_n[1]


class Sensors(Strict):
    """The proximity sensors under the beam, all of one kind."""

    count: Literal["auto"] | Annotated[int, Field(ge=MIN_SENSORS, le=MAX_SENSORS)] | tuple[PositiveInt, PositiveInt] = (
        "auto"
    )
    """How many; "auto" or a range takes the fewest that meet requirements.position_error_mm."""
    noise_mm: Annotated[float, Field(ge=0, allow_inf_nan=False)] | None = None
    """Standard deviation of one reading."""
    noise_percent_of_max: Annotated[float, Field(ge=0, allow_inf_nan=False)] | None = None
    """The same, in percent of the largest deflection in the scene."""
    rate_hz: PositiveFinite = 100.0
    range_mm: tuple[PositiveFinite, PositiveFinite] = (1.0, 4.0)
    """Gaps over which the sensor is linear."""
    standoff_mm: PositiveFinite | None = None
    """Gap at rest; left out, the travel of the beam is centred in the range."""
    adc_bits: Annotated[int, Field(ge=6, le=16)] | None = None
    """Left out, the steps of the ADC are not modelled."""
    min_distance_mm: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 0.0
    keep_out_mm: list[tuple[Finite, Finite]] = Field(default_factory=list)
    """Stretches of the beam that no sensor may stand in, ends excluded."""
    fixed_mm: list[Finite] = Field(default_factory=list)
    """Sensors that already have their place."""
    grid_mm: PositiveFinite = 1.0

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if (self.noise_mm is None) == (self.noise_percent_of_max is None):
            message = "give either noise_mm or noise_percent_of_max"
            raise ValueError(message)
        if self.range_mm[0] >= self.range_mm[1]:
            message = f"range_mm = {list(self.range_mm)}: the first must be less than the second"
            raise ValueError(message)
        if self.standoff_mm is not None and not self.range_mm[0] <= self.standoff_mm <= self.range_mm[1]:
            message = f"standoff_mm = {self.standoff_mm:g} lies outside range_mm = {list(self.range_mm)}"
            raise ValueError(message)
        twice = [place for place in self.fixed_mm if self.fixed_mm.count(place) > 1]
        if twice:
            message = f"fixed_mm names {twice[0]:g} mm twice; two sensors cannot share a place"
            raise ValueError(message)
        if any(start >= end for start, end in self.keep_out_mm):
            message = "keep_out_mm: the start of a stretch must be less than its end"
            raise ValueError(message)
        return self

    @property
    def count_range(self) -> tuple[int, int]:
        """Fewest and most sensors to consider."""
        if self.count == "auto":
            return 2, 8
        return self.count if isinstance(self.count, tuple) else (self.count, self.count)


Descriptor = Literal["position", "force"]


class Requirements(Strict):
    """What the surface is for."""

    position_error_mm: PositiveFinite | None = None
    """Mean error wanted; decides the number of sensors where it is open."""
    latency_ms: PositiveFinite | None = None
    """Time the filter may take; left out, a sample is a reading."""
    descriptors: tuple[Descriptor, ...] = ("position",)


class Scene(Strict):
    """A whole scene."""

    beam: Beam
    contact: Contact
    sensors: Sensors
    requirements: Requirements = Field(default_factory=Requirements)

    @model_validator(mode="after")
    def _on_the_beam(self) -> Self:
        low, high = self.contact.position_mm
        if low < 0 or high > self.beam.length_mm:
            message = f"contact.position_mm = {[low, high]} reaches beyond the beam, 0..{self.beam.length_mm:g} mm"
            raise ValueError(message)
        if any(not 0 <= position <= self.beam.length_mm for position in self.sensors.fixed_mm):
            message = f"sensors.fixed_mm reaches beyond the beam, 0..{self.beam.length_mm:g} mm"
            raise ValueError(message)
        if self.sensors.count != "auto" and self.sensors.count_range[0] > self.sensors.count_range[1]:
            message = "sensors.count: the first must not exceed the second"
            raise ValueError(message)
        return self

    @property
    def wants_force(self) -> bool:
        """Whether the model states the force."""
        return "force" in self.requirements.descriptors


def parse_scene(text: str, origin: str) -> Scene:
    """Read a scene from TOML text.

    Raises
    ------
    SceneError
        Not TOML, an unknown key, a missing or impossible value; the message names `origin` and the key.
    """
    try:
        return Scene.model_validate(tomllib.loads(text))
    except ValidationError as error:
        message = f"{origin}: {first_error(error)}"
        raise SceneError(message) from None
    except (ValueError, RecursionError) as error:
        # Also numbers and nesting beyond what the parser takes.
        message = f"{origin}: not valid TOML: {error}"
        raise SceneError(message) from None


def load_scene(path: Path) -> tuple[Scene, str]:
    """Read a scene file; returns the scene and its text. Raises SceneError as `parse_scene` does."""
    text = read_text(path)
    return parse_scene(text, str(path)), text


def first_error(error: ValidationError) -> str:
    """Say the first thing that is wrong in one line: the key, the reason, the value."""
    # A misspelt key is also a missing one; its spelling is what the user can see.
    first = min(error.errors(), key=lambda complaint: complaint["type"] != "extra_forbidden")
    where = ".".join(str(part) for part in first["loc"] if isinstance(part, int) or part.isidentifier())
    if first["type"] == "extra_forbidden":
        return f"unknown key {where}; take it out or correct its spelling"
    reason = first["msg"].removeprefix("Value error, ")
    given = "" if isinstance(first["input"], dict) else f" (given: {first['input']!r})"
    return f"{where}: {reason}{given}" if where else f"{reason}"
