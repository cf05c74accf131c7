"""Counts and lengths as the commands show and record them."""

from collections.abc import Sequence

from beamtouch_common.digits import digits
from beamtouch_common.units import MM
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


def heads_with_unit(heads: Sequence[str], of_unit: Sequence[str], units: Sequence[str]) -> tuple[list[str], list[str]]:
    """Return the heads of a table, and what ends the figures of its rows, whose units are `units`.

    If all rows have one unit, it is in the heads that `of_unit` names; otherwise it ends each figure.
    """
    if len(set(units)) > 1:
        return list(heads), [f" {unit}" for unit in units]
    unit = next(iter(units), MM)
    return [f"{head} {unit}" if head in of_unit else head for head in heads], [""] * len(units)
