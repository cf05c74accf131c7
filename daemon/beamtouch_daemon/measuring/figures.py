"""Counts and lengths as the commands show and record them."""

from beamtouch_common.digits import digits
from beamtouch_daemon.config.value_types import LARGEST

MAX_FRACTION = 1e6
"""Counts from which on parts of one are left out."""


def rounded(value: float, decimals: int) -> float:
    """Return a value with this number of decimals; never -0.0."""
    return round(value, decimals) + 0.0


def counts_text(counts: float) -> str:
    """Return counts: whole ones in full, means of several conversions and fractional numbers to seven digits.

    From a million on, such a mean is rounded to a whole number, because an exponent would take digits away.
    """
    is_whole = counts == int(counts) or abs(counts) >= MAX_FRACTION
    if abs(counts) > LARGEST:  # no value at all
        return f"{counts:.7g}"
    return f"{counts + 0.0:.0f}" if is_whole else digits(counts, 7)  # never -0
