"""Device time on the host's clock."""

import math
from collections import deque

import numpy as np

MAX_DRIFT = 0.01
"""The most by which a device clock may run slow or fast; a ceramic resonator is within half of it."""
ROUND_TRIPS = 60
"""So many of the last round trips are kept."""
ENOUGH_ROUND_TRIPS = 5
BEST_PART = 4
"""One in so many round trips is used, the quickest."""
MIN_SPAN_S = 5.0
"""Over less than this, round trips say nothing of the drift that their own spread does not hide."""


class HostClock:
    """Maps device times to the monotonic clock of the host.

    A frame arrives after it was sent, now sooner, now later. The smallest difference between arrival and device time so
    far stands for the offset between the two clocks, and what a frame took longer than that is its delay. As the clocks
    drift, the offset creeps upwards at `MAX_DRIFT` of the device's time until a frame holds it down again. It follows
    the device's time and not arrivals, so that a line that stood still and then delivers everything at once does not
    make old readings young.

    Round trips tell more: how long the smallest delay itself is, and the drift. Once there are some, they say where a
    device time lies, and arrivals only that it is not later.
    """

    def __init__(self) -> None:
        self._offset_s = math.inf
        self._device_s = 0.0
        self._last_s = -math.inf
        self._round_trips = RoundTrips()

    def round_trip(self, sent_s: float, device_s: float, received_s: float) -> None:
        """Take in when a ping was sent and answered [s, host], and the device's time in the answer [s]."""
        self._round_trips.add(sent_s, device_s, received_s)

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
        by_round_trips_s = self._round_trips.to_host(device_s)
        taken_s = device_s + self._offset_s if by_round_trips_s is None else by_round_trips_s
        self._last_s = max(self._last_s, min(taken_s, arrival_s))
        return self._last_s


class RoundTrips:
    """A line through questions and answers: where device times lie on the host's clock. No I/O.

    The device handled a question somewhere between its sending and the answer's arrival; the middle is wrong by half of
    that time at most. So the quickest round trips are the ones to go by. Through their middles goes a line by
    repeated medians (Siegel, Biometrika 69, 1982, 242-244): half of them may be off, as by a queue in one direction,
    and it stands. Over a short time the slope is taken for 1: what the device drifts in it is less than what they tell.
    """

    def __init__(self) -> None:
        self._trips: deque[tuple[float, float, float]] = deque(maxlen=ROUND_TRIPS)
        self._origin_device_s = 0.0
        self._origin_host_s = 0.0
        self._slope: float | None = None

    def add(self, sent_s: float, device_s: float, received_s: float) -> None:
        """Take in one round trip: host time of the question, device time, host time of the answer [s]."""
        self._trips.append((received_s - sent_s, device_s, (sent_s + received_s) / 2))
        if len(self._trips) >= ENOUGH_ROUND_TRIPS:
            self._fit()

    def to_host(self, device_s: float) -> float | None:
        """Return the host time of a device time [s]; None as long as there are too few round trips."""
        if self._slope is None:
            return None
        return self._origin_host_s + self._slope * (device_s - self._origin_device_s)

    def _fit(self) -> None:
        best = sorted(self._trips)[: max(ENOUGH_ROUND_TRIPS, len(self._trips) // BEST_PART)]
        _, device, host = np.array(best).T
        self._origin_device_s = float(device.max())
        apart, gone = device[:, None] - device, host[:, None] - host
        np.fill_diagonal(apart, np.nan)
        slope = 1.0
        if np.ptp(device) >= MIN_SPAN_S:
            slope = float(np.nanmedian(np.nanmedian(gone / apart, axis=1)))
        self._slope = min(max(slope, 1 - MAX_DRIFT), 1 + MAX_DRIFT)
        self._origin_host_s = float(np.median(host - self._slope * (device - self._origin_device_s)))
