"""Maps device times to the host's clock.

A time stamp that is too late makes an old value look fresh; one that is too early only makes it look older. So every
doubt makes a reading older. This is written by hand because clock libraries estimate the middle of a round trip, which
may be too late.
"""

import math
from collections import deque

import numpy as np

MAX_DRIFT = 0.01
"""Largest relative error of a device clock; a ceramic resonator is twice as good."""
ROUND_TRIPS = 60
"""Number of round trips that are kept."""
ENOUGH_ROUND_TRIPS = 5
"""Smallest number of round trips that determines the drift."""
BEST_PART = 4
"""The drift is estimated from the fastest round trips, one in this many."""
BEYOND_S = 1.0
"""A device time further in the future than this is wrong. If it counted, all later readings would look old."""


class HostClock:
    """Maps device times to the monotonic clock of the host.

    The offset between the two clocks lies between two bounds. The device handled a ping after the ping was sent: that
    gives the lower bound, which time stamps follow. A frame arrives after its device time: the smallest difference so
    far gives the upper bound, which no time stamp exceeds. Because the clocks drift, the upper bound rises at
    `MAX_DRIFT` of the device's time until a frame lowers it again. Both bounds follow the device's time and not
    arrivals, so old readings stay old on a line that delivers many readings in a burst.

    With at least one round trip, no time stamp is too late, however long an adapter holds readings back. It is too
    early by the time that the fastest pings took to reach the device, plus the possible drift since then. Without a
    round trip, it is too late by the smallest delay of a frame.
    """

    def __init__(self) -> None:
        self._max_offset_s = math.inf
        self._device_s = -math.inf
        self._last_s = -math.inf
        self._round_trips = RoundTrips()

    def round_trip(self, sent_s: float, device_s: float, received_s: float) -> None:
        """Add a round trip: host times of the ping and of its answer [s], and the device time in the answer [s]."""
        self._round_trips.add(sent_s, device_s, received_s)
        self.add_frame(device_s, received_s)

    def add_frame(self, device_s: float, arrival_s: float) -> None:
        """Add the device time [s] and the arrival on the host's clock [s] of a frame.

        Add all frames of a burst before the first time stamp: the newest has the smallest delay.
        """
        if math.isinf(self._device_s):
            self._device_s = device_s
        crept_s = self._max_offset_s + MAX_DRIFT * max(0.0, device_s - self._device_s)
        self._max_offset_s = min(arrival_s - device_s, crept_s)
        self._device_s = max(self._device_s, device_s)

    def is_beyond(self, device_s: float, arrival_s: float) -> bool:
        """Return whether a frame that arrived at `arrival_s` [s, host] states a device time [s] in the future."""
        earliest_s = self._round_trips.to_host(device_s)
        return earliest_s is not None and earliest_s > arrival_s + BEYOND_S

    def is_behind(self, device_s: float, sent_s: float) -> bool:
        """Return whether the answer to a ping has a device time [s] from well before the ping was sent [s, host]."""
        latest_s = device_s + self._max_offset_s + MAX_DRIFT * max(0.0, device_s - self._device_s)
        return latest_s < sent_s - BEYOND_S

    def to_host(self, device_s: float, arrival_s: float) -> float:
        """Return the time of a reading [s]: never later than its arrival, never earlier than the previous one.

        Parameters
        ----------
        device_s : Time of the reading on the device's clock.
        arrival_s : Arrival of its frame on the monotonic clock.
        """
        self.add_frame(device_s, arrival_s)
        latest_s = device_s + self._max_offset_s + MAX_DRIFT * (self._device_s - device_s)
        earliest_s = self._round_trips.to_host(device_s)
        taken_s = latest_s if earliest_s is None else min(earliest_s, latest_s)
        self._last_s = max(self._last_s, min(taken_s, arrival_s))
        return self._last_s


class RoundTrips:
    """Estimates the earliest host time of a device time from round trips. No I/O.

    The device handled a ping after it was sent, whatever delayed the answer. So the host time at that device time is
    not before the sending. The ping that reached the device fastest gives the best bound.

    The drift is the slope of a line through the middles of the fastest round trips, by repeated medians (Siegel,
    Biometrika 69, 1982, 242-244), which tolerate errors in half of them, such as a queue in one direction. The doubt of
    the slope is the duration of the longest of these round trips divided by the time that they span. Until that is less
    than `MAX_DRIFT`, the slope is 1 and the doubt is `MAX_DRIFT`. The doubt times the time since the best ping is
    subtracted.
    """

    def __init__(self) -> None:
        self._trips: deque[tuple[float, float, float]] = deque(maxlen=ROUND_TRIPS)
        self._origin_device_s = 0.0
        self._origin_host_s = 0.0
        self._slope = 1.0
        self._doubt = MAX_DRIFT

    def add(self, sent_s: float, device_s: float, received_s: float) -> None:
        """Add a round trip: host time of the ping, device time, host time of the answer [s]."""
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
