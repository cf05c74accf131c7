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

    Valid for one boot of the device: make a new clock after a `Hello` with another boot id, and after a silence of 35
    minutes.
    """

    def __init__(self) -> None:
        self._us: int | None = None

    def follow(self, device_us: int) -> int:
        """Return the device time in microseconds, counted on from the first value, which is returned unchanged.

        A value may be up to 35 minutes before or after the latest one: an answer can overtake an earlier reading, and a
        reading an earlier answer.
        """
        if self._us is None:
            self._us = device_us
        near = self._us + (device_us - self._us + (1 << 31)) % (1 << 32) - (1 << 31)
        self._us = max(self._us, near)
        return near
