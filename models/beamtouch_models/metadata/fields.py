"""The strict base class of the metadata's parts, the types of their fields, and the names of inputs and outputs."""

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, PositiveFloat

NAME = r"^[A-Za-z0-9_.-]{1,64}$"
Deviation = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Pair = Annotated[tuple[FiniteFloat, FiniteFloat], Field(strict=False)]
PositivePair = Annotated[tuple[PositiveFloat, PositiveFloat], Field(strict=False)]

INPUTS = ("deflection_mm", "whitening_per_mm")
POSITION_OUTPUTS = ("position_mm", "position_low_mm", "position_high_mm", "contact_log_odds", "misfit")
FORCE_OUTPUTS = ("force_n", "force_low_n", "force_high_n")


class MetadataPart(BaseModel):
    """A part of the metadata. It is immutable, and unknown fields are refused."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)
