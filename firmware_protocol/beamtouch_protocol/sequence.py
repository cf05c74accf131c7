"""The device's counters, which wrap, made whole again on the host."""


def missing_between(previous: int, current: int) -> int:
    """Return how many readings were lost between two that arrived one after the other.

    Parameters
    ----------
    previous, current
        Their `sequence`, modulo 2**16.

    Returns
    -------
    int
        0 to 65535. Exact as long as fewer than 2**16 readings were lost; a longer silence is for the host's own clock
        to notice.
    """
    return (current - previous - 1) % (1 << 16)


class DeviceClock:
    """Extends `device_us`, which wraps every 71.6 minutes, to a count that does not.

    Never runs backwards. It holds for one boot of the device, and for readings less than 71.6 minutes apart: make a
    new one after a Hello with another boot id, and after any longer silence.
    """

    def __init__(self) -> None:
        self._us: int | None = None

    def extend(self, device_us: int) -> int:
        """Return the device time in microseconds; the first value stands as it is, the others count on from there."""
        if self._us is None:
            self._us = device_us
        else:
            self._us += (device_us - self._us) % (1 << 32)
        return self._us

    def extend_near(self, device_us: int) -> int:
        """Return the device time in microseconds of a value that may be a little older than the last; moves nothing.

        An answer can overtake a reading that was taken before it, and the other way round.
        """
        if self._us is None:
            return device_us
        return self._us + (device_us - self._us + (1 << 31)) % (1 << 32) - (1 << 31)

    def follow(self, device_us: int) -> int:
        """Return the device time in microseconds of a value near the last, and move on to it if it is later."""
        near = self.extend_near(device_us)
        self._us = near if self._us is None else max(self._us, near)
        return near
