"""Device time on the host's clock."""

import math

MAX_DRIFT = 0.01
"""The most by which a device clock may run slow; a ceramic resonator is within half of it."""


class HostClock:
    """Maps device times to the monotonic clock of the host.

    A frame arrives after it was sent, now sooner, now later. The smallest difference between arrival and device time so
    far stands for the offset between the two clocks, and what a frame took longer than that is its delay. As the clocks
    drift, the offset creeps upwards at `MAX_DRIFT` of the device's time until a frame holds it down again. It follows
    the device's time and not arrivals, so that a line that stood still and then delivers everything at once does not
    make old readings young.
    """

    def __init__(self) -> None:
        self._offset_s = math.inf
        self._device_s = 0.0
        self._last_s = -math.inf

    def to_host(self, device_s: float, arrival_s: float) -> float:
        """Return when a reading was taken [s]: never later than its arrival, never earlier than the one before.

        Parameters
        ----------
        device_s
            Its time on the device's clock, which must not run backwards.
        arrival_s
            When its frame arrived, on the monotonic clock.
        """
        crept_s = self._offset_s + MAX_DRIFT * (device_s - self._device_s)
        self._offset_s = min(arrival_s - device_s, crept_s)
        self._device_s = device_s
        self._last_s = max(self._last_s, min(device_s + self._offset_s, arrival_s))
        return self._last_s
