"""Rounds numbers to significant digits, as text without an exponent."""

import math

MAX_DECIMALS = 6
"""Of a length in mm, a nanometre: less than any sensor resolves."""
MIN_PLAIN, MAX_PLAIN = 1e-6, 1e7
"""Sizes between which a number is written without an exponent."""


def digits(value: float, count: int) -> str:
    """Return a number rounded to `count` significant digits: 160, not 1.6e+02, and 0.00002, not 2e-05.

    An exponent is left to numbers of less than 0.000001, and of 10 million and more.
    """
    text = f"{value:.{count}g}"
    if "e" not in text or not MIN_PLAIN <= abs(float(text)) < MAX_PLAIN:
        return text
    decimals = count - 1 - math.floor(math.log10(abs(float(text))))
    plain = f"{float(text):.{max(decimals, 0)}f}"
    return plain.rstrip("0").rstrip(".") if decimals > 0 else plain


def decimals_of(smallest: float) -> int:
    """Return the decimals that a number needs to show a change of this size; at most `MAX_DECIMALS`."""
    return min(max(math.ceil(-math.log10(smallest)), 0), MAX_DECIMALS) if smallest > 0 else MAX_DECIMALS
