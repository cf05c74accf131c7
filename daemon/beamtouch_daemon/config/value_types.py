"""Data types of values in Modbus registers: how many registers they take, where they end, and what they resolve."""

import math
import struct
from typing import Literal

ValueType = Literal["u16", "i16", "u32", "i32", "f32", "f64"]
"""Data type of a value: a whole number, or a fractional number (f32, f64)."""
ByteOrder = Literal["ABCD", "CDAB", "BADC", "DCBA"]
"""Order of the bytes of a value in several registers."""

FORMATS: dict[ValueType, str] = {"u16": ">H", "i16": ">h", "u32": ">I", "i32": ">i", "f32": ">f", "f64": ">d"}
"""Format of a value in the module `struct`, the most significant byte first."""
LARGEST = 1e12
"""Largest size of a value. A larger one stands for none, as NaN does: some devices send the largest number there is."""
_DIGITS = {"f32": 24, "f64": 53}
"""Binary digits of a fractional number."""
WHOLE = 1.0
"""Smallest change of a whole number."""


def words_of(value_type: ValueType) -> int:
    """Return the number of registers of a value."""
    return struct.calcsize(FORMATS[value_type]) // 2


def has_fractions(value_type: ValueType) -> bool:
    """Return whether values are fractional numbers."""
    return value_type in _DIGITS


def ends_of(value_type: ValueType) -> tuple[float, float]:
    """Return the smallest and the largest value; fractional numbers have no ends."""
    if has_fractions(value_type):
        return -math.inf, math.inf
    values = 2.0 ** (16 * words_of(value_type))
    return (-values / 2, values / 2 - 1) if value_type.startswith("i") else (0.0, values - 1)


def spacing_of(value_type: ValueType, value: float) -> float:
    """Return the smallest change that a value of this size can show."""
    digits = _DIGITS.get(value_type)
    return WHOLE if digits is None else math.ulp(value) * 2.0 ** (53 - digits)
