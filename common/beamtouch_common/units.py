"""The unit of what a channel shows: a gap in mm, or any other one, such as uV/V of a strain gauge."""

from typing import Annotated

from pydantic import AfterValidator, Field

from beamtouch_common.digits import digits

MM = "mm"
"""The unit of a gap, and of a channel that states none."""
UNIT = r"[A-Za-z%\u00b5\u03bc][A-Za-z0-9%/.^*-]{0,15}"
"""Letters, digits and signs of a product; without `_`, which separates it from a name in a column."""
LENGTHS_MM = {"nm": 1e-6, "um": 1e-3, "cm": 10.0, "m": 1000.0}
"""Other units of a length, in mm."""


def plain(unit: str) -> str:
    """Return a unit with u for a Greek mu, of which there are two."""
    return unit.replace("\u00b5", "u").replace("\u03bc", "u")


def _no_other_length(unit: str) -> str:
    if unit in LENGTHS_MM:
        raise ValueError(f"lengths are in mm, not {unit}; one {unit} is {LENGTHS_MM[unit]:g} mm")
    return unit


Unit = Annotated[str, Field(pattern=f"^{UNIT}$"), AfterValidator(plain), AfterValidator(_no_other_length)]
"""Unit of a channel. Figures whose names end in `_mm` are in it, and those in `_um` in a thousandth of it."""


def direction_of(unit: str) -> float:
    """Return how a value changes under a load that shows positively: -1 for a gap, which closes, 1 for other units."""
    return -1.0 if unit == MM else 1.0


def fine_unit(unit: str) -> tuple[str, float]:
    """Return the unit of small values for people, um if they are lengths in mm, and how many of it are a `unit`."""
    return ("um", 1e3) if unit == MM else (unit, 1.0)


def fine(value: float, unit: str, count: int = 3) -> str:
    """Return a small value with its unit as text; `count` digits."""
    small, times = fine_unit(unit)
    return f"{digits(times * value, count)} {small}"
