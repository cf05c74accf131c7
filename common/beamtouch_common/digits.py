"""Rounds numbers to significant digits, as text without an exponent, and the numbers in the text of an object."""

import math
from dataclasses import fields
from decimal import Decimal
from typing import Any

MAX_DECIMALS = 6
"""Decimals of a length in mm: a nanometre is less than any sensor resolves."""
SHOWN = 4
"""Digits of a number in the text of an object, and more than most of them are known to."""
LISTED = 8
"""Entries of a list in the text of an object."""
MIN_PLAIN, MAX_PLAIN = 1e-6, 1e7
"""Sizes between which a number is written without an exponent."""


def digits(value: float, count: int) -> str:
    """Return a number rounded to `count` significant digits: 160, not 1.6e+02, and 0.00002, not 2e-05.

    An exponent is left to numbers of less than 0.000001, and of 10 million and more.
    """
    text = f"{value:.{count}g}"
    if "e" not in text or not MIN_PLAIN <= abs(float(text)) < MAX_PLAIN:
        return text
    return f"{Decimal(text):f}"


def decimals_of(smallest: float) -> int:
    """Return the decimals that a number needs to show a change of this size; at most `MAX_DECIMALS`."""
    return min(max(math.ceil(-math.log10(smallest)), 0), MAX_DECIMALS) if smallest > 0 else MAX_DECIMALS


def rounded(value: object) -> str:
    """Return the text of a value with its numbers rounded to `SHOWN` digits, and no more than `LISTED` of a list."""
    if hasattr(value, "tolist"):  # of numpy, which this module does without
        value = value.tolist()
    if isinstance(value, float):
        return digits(value, SHOWN)
    if isinstance(value, dict):
        return f"{{{', '.join(f'{key!r}: {rounded(entry)}' for key, entry in value.items())}}}"
    if not isinstance(value, list | tuple):
        return repr(value)
    texts = [rounded(entry) for entry in value[:LISTED]] + [f"... {len(value)} in all"] * (len(value) > LISTED)
    return f"[{', '.join(texts)}]" if isinstance(value, list) else f"({', '.join(texts)})"


class Rounded:
    """A dataclass whose text has rounded numbers; `dataclass(repr=False)` leaves the text to this."""

    def __repr__(self) -> str:
        """Return the fields with their values."""
        owner: Any = self
        shown = [field.name for field in fields(owner) if field.repr]
        return f"{type(self).__name__}({', '.join(f'{name}={rounded(getattr(self, name))}' for name in shown)})"
