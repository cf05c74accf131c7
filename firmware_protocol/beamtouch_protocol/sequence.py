"""Unwrapping of the device's counters on the host."""


def missing_between(previous: int, current: int) -> int:
    """Return how many readings were lost between two that arrived in succession.

    Parameters
    ----------
    previous, current
        Their `sequence`, modulo 2**16.

    Returns
    -------
    int
        0 to 65535, exact if fewer than 2**16 readings were lost. The host's own clock must detect a longer silence.
    """
    return (current - previous - 1) % (1 << 16)


class DeviceClock:
    """Extends `device_us`, which wraps every 71.6 minutes, to a count that does not wrap.

    Never runs backwards. Valid for one boot of the device and for readings less than 71.6 minutes apart: make a new
    clock after a `Hello` with another boot id, and after a longer silence.
    """

    def __init__(self) -> None:
        self._us: int | None = None

    def extend(self, device_us: int) -> int:
        """Return the device time in microseconds, counted on from the first value, which is returned unchanged."""
        if self._us is None:
            self._us = device_us
        else:
            self._us += (device_us - self._us) % (1 << 32)
        return self._us

    def extend_near(self, device_us: int) -> int:
        """Return the device time in microseconds of a value up to 35 minutes before or after the last one.

        It leaves the clock unchanged. An answer can overtake an earlier reading, and a reading an earlier answer.
        """
        if self._us is None:
            return device_us
        return self._us + (device_us - self._us + (1 << 31)) % (1 << 32) - (1 << 31)

    def follow(self, device_us: int) -> int:
        """Return the device time in microseconds of a value near the last, and move on to it if it is later."""
        near = self.extend_near(device_us)
        self._us = near if self._us is None else max(self._us, near)
        return near
