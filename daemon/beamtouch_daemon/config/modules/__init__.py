"""Known analog input modules: a TOML file each, with the registers that the manual states."""

import tomllib
from functools import lru_cache
from importlib import resources
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat

from beamtouch_daemon.config.value_types import ValueType, words_of


class Module(BaseModel):
    """Properties of a module."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)

    kind: Literal["modbus-tcp", "modbus-rtu"] | None = None
    """Required kind of source; None: any."""
    inputs: Annotated[int, Field(ge=1)]
    first_register: Annotated[int, Field(ge=0, le=65_535)]
    """Register of input 0; the other inputs follow without a gap."""
    function: Literal[3, 4]
    type: ValueType
    max_registers: Annotated[int, Field(ge=1, le=125)]
    """Limit of registers in one request."""
    max_hz: Annotated[FiniteFloat, Field(gt=0)] | None = None
    """Conversions per second of each input; None: unknown, or on each request."""

    def register_of(self, number: int) -> int:
        """Return the register of an input, counted from 0."""
        return self.first_register + number * words_of(self.type)


def names() -> list[str]:
    """Return the names of all modules."""
    files = resources.files(__name__).iterdir()
    return sorted(file.name.removesuffix(".toml") for file in files if file.name.endswith(".toml"))


@lru_cache
def module_of(name: str) -> Module:
    """Return a module; ValueError if its name is unknown."""
    if name not in names():
        raise ValueError(f"there is no module {name}; choose one of {', '.join(names())}")
    text = (resources.files(__name__) / f"{name}.toml").read_text(encoding="utf-8")
    return Module.model_validate(tomllib.loads(text))
