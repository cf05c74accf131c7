"""The strict base class of the metadata's parts, and the types of their fields."""

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, PositiveFloat

NAME = r"^[A-Za-z0-9_.-]{1,64}$"
Deviation = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Pair = Annotated[tuple[FiniteFloat, FiniteFloat], Field(strict=False)]
PositivePair = Annotated[tuple[PositiveFloat, PositiveFloat], Field(strict=False)]


class MetadataPart(BaseModel):
    """A part of the metadata. It is immutable, and unknown fields are refused."""

    model_config = ConfigDict(
        extra="forbid", strict=True, frozen=True, validate_by_name=True, validate_by_alias=True, serialize_by_alias=True
    )
