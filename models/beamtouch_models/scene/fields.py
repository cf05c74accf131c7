"""The base class and the types of numbers of everything that a user states in a file."""

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

Finite = Annotated[float, Field(allow_inf_nan=False)]
PositiveFinite = Annotated[float, Field(gt=0, allow_inf_nan=False)]
DampingRatio = Annotated[float, Field(gt=0, lt=1)]
Fixity = Annotated[float, Field(ge=0, lt=1)]
Pair = Annotated[tuple[Finite, Finite], Field(strict=False)]
PositivePair = Annotated[tuple[PositiveFinite, PositiveFinite], Field(strict=False)]


class Strict(BaseModel):
    """Base class of what a user states: immutable, refuses unknown keys, converts no types."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, use_attribute_docstrings=True)
