"""The clock of ages: it never goes back, and nobody sets it."""

from time import CLOCK_BOOTTIME, clock_gettime


def uptime_s() -> float:
    """Return the time since the machine started [s]. It includes sleep: what is from before a suspend is old."""
    return clock_gettime(CLOCK_BOOTTIME)
