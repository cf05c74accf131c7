"""Times of samples, which the clock of their daemon gives. Pure: the caller gives the time."""

AHEAD_S = 86_400.0
"""A time further ahead than this comes from a clock that was wrong. A mistaken zone is less than a day."""


def latest_us(now_s: float) -> int:
    """Return the latest time that can be true [us since 1970], at this time [s since 1970]."""
    return round((now_s + AHEAD_S) * 1e6)
