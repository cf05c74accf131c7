"""Devices that give values as fractional numbers, or as whole numbers of 32 bits, and their configurations."""

from collections.abc import Callable, Sequence
from typing import Any, Literal

from pymodbus.client.mixin import ModbusClientMixin
from pymodbus.simulator.simdevice import SimAction

from support.surfaces import configs

TYPES = {"u16": "UINT16", "i16": "INT16", "u32": "UINT32", "i32": "INT32", "f32": "FLOAT32", "f64": "FLOAT64"}


def registers_of(values: Sequence[float], value_type: str = "f32", order: str = "ABCD") -> list[int]:
    """Return the registers of values, as pymodbus writes them."""
    kind: Any = getattr(ModbusClientMixin.DATATYPE, TYPES[value_type])
    words: Literal["big", "little"] = "little" if order in ("CDAB", "DCBA") else "big"
    taken = [value if value_type.startswith("f") else round(value) for value in values]
    registers = [word for value in taken for word in ModbusClientMixin.convert_to_registers(value, kind, words)]
    return [word >> 8 | (word & 255) << 8 for word in registers] if order in ("BADC", "DCBA") else registers


def measures(values: Callable[[], Sequence[float]], value_type: str = "f32") -> SimAction:
    """Return what makes a device measure on each request."""

    async def action(_function: int, _start: int, _address: int, _count: int, now: list[int], _set: object) -> None:
        registers = registers_of(values(), value_type)
        now[: len(registers)] = registers

    return action


def surface(
    port: int,
    value_type: str = "f32",
    *,
    name: str = "bench",
    first: int = 0,
    gain: float = 1.0,
    offset_mm: float = 0.0,
    more: str = "",
) -> str:
    """Return a surface of two channels; by default the values of the device are gaps in mm, 2.5 at rest.

    `first` is the first register, and `more` has keys of the surface.
    """
    registers = first, first + {"16": 1, "32": 2, "64": 4}[value_type[1:]]
    text = configs.surface(name, configs.tcp(port), registers=registers).replace("rate_hz", f"{more}\nrate_hz", 1)
    characteristic = f'type = "{value_type}"\ngain_mm_per_count = {gain}\noffset_mm = {offset_mm}'
    return text.replace("gain_mm_per_count = -0.0001\noffset_mm = 4.5", characteristic)
