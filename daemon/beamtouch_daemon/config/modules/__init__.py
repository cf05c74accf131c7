"""Analog input modules that are known by name: where their inputs are, as their manuals say. A TOML file each."""

import tomllib
from functools import lru_cache
from importlib import resources
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat

Encoding = Literal["u16", "i16", "u32", "i32", "f32"]
"""How a value lies in its registers; 32 bits take two of them."""


class Module(BaseModel):
    """What is known of a module."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)

    about: str
    kind: Literal["modbus-tcp", "modbus-rtu"] | None = None
    """How it is reached; None: either way."""
    inputs: Annotated[int, Field(ge=1)]
    first_register: Annotated[int, Field(ge=0, le=65_535)]
    """Register of input 0; the others follow without a gap."""
    function: Literal[3, 4]
    type: Encoding
    max_registers: Annotated[int, Field(ge=1, le=125)]
    """The most that one request may ask for."""
    most_hz: Annotated[FiniteFloat, Field(gt=0)] | None = None
    """How often it converts; None: not known, or as often as it is asked."""

    def register_of(self, number: int) -> int:
        """Return the register of an input, counted from 0."""
        return self.first_register + number * words_of(self.type)


def words_of(encoding: Encoding) -> int:
    """Return how many registers a value takes."""
    return 1 if encoding in {"u16", "i16"} else 2


def names() -> list[str]:
    """Return the names of all modules."""
    files = resources.files(__name__).iterdir()
    return sorted(file.name.removesuffix(".toml") for file in files if file.name.endswith(".toml"))


@lru_cache
def module_of(name: str) -> Module:
    """Return what is known of a module; ValueError if its name is not known."""
    if name not in names():
        message = f"there is no module {name}; there are {', '.join(names())}"
        raise ValueError(message)
    text = (resources.files(__name__) / f"{name}.toml").read_text(encoding="utf-8")
    return Module.model_validate(tomllib.loads(text))
