"""Rounding of the bounds that messages name."""

import math


def at_most(value: float) -> float:
    """Return the largest number with two digits that is not more than a value; 0 for less than 1e-300."""
    if value < 1e-300:
        return 0.0
    digit = 10.0 ** (math.floor(math.log10(value)) - 1)
    return math.floor(value / digit) * digit
