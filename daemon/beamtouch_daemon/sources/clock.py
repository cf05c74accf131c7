"""Device time on the host's clock.

A stamp that is later than the truth makes an old value look fresh; one that is earlier only makes it look older. So
whatever is not known counts as age.
"""

import math
from collections import deque

import numpy as np

MAX_DRIFT = 0.01
"""The most by which a device clock may run slow or fast; a ceramic resonator is within half of it."""
ROUND_TRIPS = 60
"""So many of the last round trips are kept."""
ENOUGH_ROUND_TRIPS = 5
"""From so many on they tell the drift."""
BEST_PART = 4
"""One in so many round trips is used for the drift, the quickest."""
BEYOND_S = 1.0
"""A device time that has not come yet by so much is wrong; taken in, it would make all later readings old."""


class HostClock:
    """Maps device times to the monotonic clock of the host.

    The offset between the two clocks lies between two bounds. The device handled a ping after it was sent: that is the
    lower bound, and stamps follow it. A frame arrived after its device time: the smallest difference so far is the
    upper bound, and no stamp passes it. As the clocks drift, the upper bound creeps upwards at `MAX_DRIFT` of the
    device's time until a frame holds it down again. Both follow the device's time and not arrivals, so that a line that
    delivers many readings at once does not make old readings young.

    With at least one round trip no stamp is later than the truth, however long an adapter holds readings back. It is
    earlier by what the quickest pings took to reach the device, and by what the drift may be since. Without any round
    trip it is later by the smallest delay of a frame.
    """

    def __init__(self) -> None:
        self._most_offset_s = math.inf
        self._device_s = -math.inf
        self._last_s = -math.inf
        self._round_trips = RoundTrips()

    def round_trip(self, sent_s: float, device_s: float, received_s: float) -> None:
        """Take in when a ping was sent and answered [s, host], and the device's time in the answer [s]."""
        self._round_trips.add(sent_s, device_s, received_s)
        self.heard(device_s, received_s)

    def heard(self, device_s: float, arrival_s: float) -> None:
        """Take in that a frame of this device time [s] arrived then [s, host]; of a burst all before the first stamp.

        The newest frame of a burst tells most: the others waited for it.
        """
        if math.isinf(self._device_s):
            self._device_s = device_s
        crept_s = self._most_offset_s + MAX_DRIFT * max(0.0, device_s - self._device_s)
        self._most_offset_s = min(arrival_s - device_s, crept_s)
        self._device_s = max(self._device_s, device_s)

    def is_beyond(self, device_s: float, arrival_s: float) -> bool:
        """Whether a frame that arrived then [s, host] states a device time [s] that cannot have come yet."""
        earliest_s = self._round_trips.to_host(device_s)
        return earliest_s is not None and earliest_s > arrival_s + BEYOND_S

    def is_behind(self, device_s: float, sent_s: float) -> bool:
        """Whether the answer to a ping that was sent then [s, host] states a device time [s] from well before it."""
        latest_s = device_s + self._most_offset_s + MAX_DRIFT * max(0.0, device_s - self._device_s)
        return latest_s < sent_s - BEYOND_S

    def to_host(self, device_s: float, arrival_s: float) -> float:
        """Return when a reading was taken [s]: never later than its arrival, never earlier than the one before.

        Parameters
        ----------
        device_s
            Its time on the device's clock.
        arrival_s
            When its frame arrived, on the monotonic clock.
        """
        self.heard(device_s, arrival_s)
        latest_s = device_s + self._most_offset_s + MAX_DRIFT * (self._device_s - device_s)
        earliest_s = self._round_trips.to_host(device_s)
        taken_s = latest_s if earliest_s is None else min(earliest_s, latest_s)
        self._last_s = max(self._last_s, min(taken_s, arrival_s))
        return self._last_s


class RoundTrips:
    """What questions and answers tell of two clocks: the earliest host time of a device time. No I/O.

    The device handled a question after it was sent and before its answer arrived. So host time at that device time is
    not before the sending, whatever the answer waited for on its way. The question that tells most is the one that
    travelled quickest.

    The drift is the slope of a line through the middles of the quickest round trips, by repeated medians (Siegel,
    Biometrika 69, 1982, 242-244): half of them may be off, as by a queue in one direction, and it stands. The longest
    of them, over the time between the first and the last, is the doubt about it. Until that is less than `MAX_DRIFT`,
    the slope is 1 and the doubt is `MAX_DRIFT`. The time from the question that tells most, times the doubt, is taken
    off.
    """

    def __init__(self) -> None:
        self._trips: deque[tuple[float, float, float]] = deque(maxlen=ROUND_TRIPS)
        self._origin_device_s = 0.0
        self._origin_host_s = 0.0
        self._slope = 1.0
        self._doubt = MAX_DRIFT

    def add(self, sent_s: float, device_s: float, received_s: float) -> None:
        """Take in one round trip: host time of the question, device time, host time of the answer [s]."""
        self._trips.append((received_s - sent_s, device_s, sent_s))
        if len(self._trips) >= ENOUGH_ROUND_TRIPS:
            self._find_drift()
        falls = self._slope - self._doubt
        _, self._origin_device_s, self._origin_host_s = max(self._trips, key=lambda trip: trip[2] - falls * trip[1])

    def to_host(self, device_s: float) -> float | None:
        """Return the earliest host time of a device time [s]; None before the first round trip."""
        if not self._trips:
            return None
        gone_s = device_s - self._origin_device_s
        return self._origin_host_s + self._slope * gone_s - self._doubt * abs(gone_s)

    def _find_drift(self) -> None:
        best = sorted(self._trips)[: max(ENOUGH_ROUND_TRIPS, len(self._trips) // BEST_PART)]
        took, device, sent = np.array(best).T
        span_s = float(np.ptp(device))
        self._slope, self._doubt = 1.0, MAX_DRIFT
        if took.max() < MAX_DRIFT * span_s:
            host = sent + took / 2
            apart, gone = device[:, None] - device, host[:, None] - host
            np.fill_diagonal(apart, np.nan)
            slope = float(np.nanmedian(np.nanmedian(gone / apart, axis=1)))
            self._slope = min(max(slope, 1 - MAX_DRIFT), 1 + MAX_DRIFT)
            self._doubt = float(took.max()) / span_s
