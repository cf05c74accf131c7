"""The scene of a surface, validated strictly."""

from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from beamtouch_common.digits import digits
from beamtouch_common.files import parse_toml, read_text
from beamtouch_models.metadata import MAX_FALSE, max_false_per_day
from beamtouch_models.scene.beam import Beam
from beamtouch_models.scene.contact import Contact
from beamtouch_models.scene.environment import Environment
from beamtouch_models.scene.fields import PositiveFinite, Strict
from beamtouch_models.scene.misplaced import misplaced
from beamtouch_models.scene.other_units import in_other_units
from beamtouch_models.scene.sensors import Sensors

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
    descriptors: Annotated[tuple[Descriptor, ...], Field(strict=False)] = ("position",)
    """Figures that the model states; the position is always one of them."""


class Scene(Strict):
    """Statements of the user about a surface before it is built."""

    beam: Beam
    """The beam, with its supports and its foundation."""
    contact: Contact
    """The contacts that the surface is designed for."""
    sensors: Sensors
    """The proximity sensors under the beam."""
    requirements: Requirements = Field(default_factory=Requirements)
    """Requirements of the surface; all have defaults."""
    environment: Environment = Field(default_factory=Environment)
    """Temperatures around the surface."""

    @model_validator(mode="after")
    def _on_the_beam(self) -> Self:
        if message := in_other_units(self.beam):  # before other checks stumble over such a number
            raise ValueError(message)
        if message := misplaced(self.beam, self.contact, self.sensors):
            raise ValueError(message)
        if self.sensors.count != "auto" and self.sensors.count_range[0] > self.sensors.count_range[1]:
            message = f"sensors.count = {list(self.sensors.count_range)}: the first must not exceed the second"
            raise ValueError(message)
        return self

    @model_validator(mode="after")
    def _within_reason(self) -> Self:
        if self.sensors.drift_um_per_k is not None and self.environment.temperature_range_k is None:
            message = "sensors.drift_um_per_k needs environment.temperature_range_k, as [-10, 15]"
            raise ValueError(message)
        tolerance, fewest = self.sensors.mounting_tolerance_mm, self.sensors.count_range[0]
        if tolerance >= (spacing := self.beam.length_mm / fewest):
            message = (
                f"sensors.mounting_tolerance_mm = {tolerance:g}: {fewest} sensors on {self.beam.length_mm:g} mm are "
                f"{digits(spacing, 3)} mm apart; measure their positions to less than that"
            )
            raise ValueError(message)
        often, rate_hz = self.requirements.false_contacts_per_day, self.sensors.rate_hz
        if often > (most := max_false_per_day(rate_hz)):
            message = (
                f"requirements.false_contacts_per_day = {often:g}: at sensors.rate_hz = {rate_hz:g} at most "
                f"{digits(most, 6)} a day, one sample in {1 / MAX_FALSE:g}; state less"
            )
            raise ValueError(message)
        return self

    @property
    def wants_force(self) -> bool:
        """Whether the model states the force."""
        return "force" in self.requirements.descriptors


def load_scene(path: Path) -> tuple[Scene, str]:
    """Read a scene file; returns the scene and its text. Raises InputError as `parse_scene` does."""
    text = read_text(path)
    return parse_scene(text, str(path)), text


def parse_scene(text: str, origin: str) -> Scene:
    """Read a scene from TOML text; raises InputError as `beamtouch_common.files.parse_toml` does."""
    return parse_toml(Scene, text, origin)
