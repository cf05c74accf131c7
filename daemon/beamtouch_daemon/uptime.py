"""The clock of the times and ages of readings."""

from time import CLOCK_BOOTTIME, clock_gettime


def uptime_s() -> float:
    """Return the time since the machine started [s]. It includes sleep: a reading from before a suspend is old."""
    return clock_gettime(CLOCK_BOOTTIME)
