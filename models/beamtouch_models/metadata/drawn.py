"""The beam as a page draws it."""

from typing import Annotated, Literal, Self

from pydantic import Field, FiniteFloat, NonNegativeFloat, model_validator

from beamtouch_models.metadata.fields import MetadataPart


class DrawnSupport(MetadataPart):
    """A support of the beam, as a page draws it."""

    at_mm: FiniteFloat
    kind: Literal["simple", "fixed"]
    slides: bool | None = None
    """Whether the beam can move lengthwise on it; None in older files."""


class Drawn(MetadataPart):
    """The beam as a page draws it."""

    supports: list[DrawnSupport]
    """From left to right."""
    at_mm: Annotated[list[FiniteFloat], Field(min_length=2)]
    """Positions along the beam at which the deflection is given, ascending."""
    load_mm: Annotated[list[FiniteFloat], Field(min_length=1)]
    """Positions of the contact for which it is given."""
    deflection_mm_per_n: list[list[FiniteFloat]]
    """For each position of the contact, the deflection along the beam."""
    sensor_mm: NonNegativeFloat | None = None
    """Width of a sensor's housing along the beam; None in older files."""

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
