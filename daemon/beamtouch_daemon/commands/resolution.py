"""Rounding of readings to what their sensor resolves."""

import math

from beamtouch_common.digits import digits

MAX_DECIMALS = 6
"""A nanometre: less than any sensor resolves."""
MAX_FRACTION = 1e6
"""Counts from which on parts of one are left out."""


def decimals_of(step_mm: float, noise_mm: float | None) -> int:
    """Return the decimals of a length in mm that one count or the noise of a reading, if it is larger, allows.

    Parameters
    ----------
    step_mm
        Change of the gap with one count [mm].
    noise_mm
        Standard deviation of a reading [mm], if known.
    """
    smallest_mm = max(step_mm, noise_mm or 0.0)
    return min(max(math.ceil(-math.log10(smallest_mm)), 0), MAX_DECIMALS) if smallest_mm > 0 else MAX_DECIMALS


def rounded(value: float, decimals: int) -> float:
    """Return a value with this number of decimals; never -0.0."""
    return round(value, decimals) + 0.0


def counts_text(counts: float) -> str:
    """Return counts: whole ones in full, means of several conversions and floating-point values to seven digits.

    From a million on, such a mean is rounded to a whole number, because an exponent would take digits away.
    """
    return f"{counts:.0f}" if counts == int(counts) or abs(counts) >= MAX_FRACTION else digits(counts, 7)
