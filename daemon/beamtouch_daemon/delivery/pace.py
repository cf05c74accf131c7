"""Sizes of requests and times between them, by what answers and timeouts show of the line. Pure: no clock.

A request takes longer than the quickest one by the time that its bytes need on the line, that others hold it up there,
and that the service works on it. The backlog keeps this at a fifth of a second, so that nothing waits for longer behind
it. Each boot has a pace of its own, and sees in its own times what all others take of the same line.
"""

import math

from beamtouch_service.samples import MAX_SAMPLES

PART_S = 0.25
"""Time that a request of the backlog may take beyond the quickest one, unless answers are stale soon: a fifth of a
second on the line, and what the live batch before it takes."""
SHORT_S = 0.2
"""Requests that take longer than this, whatever their size, may hold more than the usual number of samples."""
MAX_BATCH = min(250, MAX_SAMPLES)
MAX_BATCH_VALUES = 40_000
"""Limits of samples and of values, covariances included, in one batch: under half of the MiB that is accepted."""
FIRST_PART = 10
"""The first request of a backlog holds the largest number over this: nothing is known of the line yet."""
NEWEST = 3
"""Samples that show the state of a surface of which nothing is known: a live batch holds no more of them where the line
is thin and the backlog brings the others."""
STALE_S = 0.5
"""Age at which an answer is stale, until a receipt states it. The shares below are of this age."""
PART_SHARE = 0.5
"""A request of the backlog takes at most this share."""
REST_SHARE = 0.3
"""The longest rest from the begin of one live batch to the next is this share."""
BESIDE_SHARE = 0.6
"""That rest is this share while a request of the backlog is in flight. At its end a live batch goes out, which is newer
than one that would have stood behind it."""
WINDOW_S = 30.0
"""The quickest request is that of the last one to two windows with answers."""
TIMEOUT_S, LONG_TIMEOUT_S = 2.0, 4.0
"""Time limit of a request, and after a timeout: on a long way, a connection takes seconds to begin."""


def most_in_batch(channels: int, samples: int = MAX_BATCH) -> int:
    """Return the limit of samples with so many channels in one batch, at most `samples`."""
    return min(samples, MAX_BATCH_VALUES // (channels + channels * (channels + 1) // 2))


class RequestPace:
    """Sizes of the requests of one boot, and the times between them."""

    def __init__(self, channels: int) -> None:
        self.stale_s: float | None = None
        """Age at which an answer is stale, by the last receipt [s]; None before the first."""
        self.timeout_s = TIMEOUT_S
        """Time limit of the next request."""
        self.is_thin = False
        """True if a request took too long beyond the quickest one, and none of the usual size has been in time since:
        for the line, or for the service."""
        self._usual = most_in_batch(channels)
        self._limit = most_in_batch(channels, MAX_SAMPLES)
        self.most = max(1, self._usual // FIRST_PART)
        """Limit of samples in the next request of the backlog."""
        self._sizes = _Slope()
        self._least_s = self._former_s = math.inf
        """Time of the quickest request in this window, and in the one before it."""
        self._ends_s = -math.inf

    def answered(self, samples: int, took_s: float, now_s: float, *, is_backlog: bool) -> None:
        """Note that a request with so many samples was answered with a receipt, at `now_s` [s, monotonic]."""
        if now_s > self._ends_s:
            self._former_s, self._least_s, self._ends_s = self._least_s, math.inf, now_s + WINDOW_S
        self._least_s = min(self._least_s, took_s)
        self.timeout_s = max(TIMEOUT_S, min(4 * self._quickest_s, LONG_TIMEOUT_S))
        beyond_s = took_s - self._quickest_s
        if is_backlog and samples:
            self._sizes.add(samples, took_s)
            # What is slow whatever its size does not become quicker by being smaller.
            beyond_s = min(beyond_s, samples * self._sizes.slope)
        self.is_thin |= beyond_s > self._part_s
        if self._says_much(samples):
            self._resize(samples, beyond_s, took_s)

    def _resize(self, samples: int, beyond_s: float, took_s: float) -> None:
        fits = samples * min(max(0.5, self._part_s / max(beyond_s, 1e-9)), 2)
        if beyond_s > self._part_s:
            self.most = max(1, int(fits))
            return
        # Where each takes long, requests are larger: as many samples a second as where none does.
        limit = min(self._limit, round(self._usual * max(1.0, took_s / SHORT_S)))
        self.most = min(max(self.most, math.ceil(fits)), limit)
        self.is_thin &= self.most < self._usual

    def unanswered(self, samples: int, took_s: float) -> None:
        """Note that a request with so many samples got no receipt in this time, and no reason not to send it."""
        if took_s >= self.timeout_s:
            self.timeout_s = LONG_TIMEOUT_S
        if took_s > self._part_s + (self._quickest_s if math.isfinite(self._quickest_s) else 0.0):
            self.is_thin = True
            if self._says_much(samples):
                self.halve(samples)

    def halve(self, samples: int) -> None:
        """Send half of so many samples next time."""
        self.most = max(1, samples // 2)

    def live_limit(self, *, is_behind: bool) -> int:
        """Return the limit of samples in a live batch: half of a request of the backlog, or the newest."""
        return NEWEST if self.is_thin and is_behind else max(NEWEST, math.ceil(self.most / 2))

    def rest_s(self, took_s: float) -> float:
        """Return the time from the begin of a live batch that took so long to the next one [s], on a thin line."""
        return min(3 * took_s, REST_SHARE * self._stale_s)

    @property
    def beside_s(self) -> float:
        """That time while a request of the backlog is in flight on a thin line [s]."""
        return BESIDE_SHARE * self._stale_s

    @property
    def overlap_s(self) -> float:
        """That time while the former one has no answer [s]; infinite: it waits for the answer."""
        shortest_s, way_s = REST_SHARE * self._stale_s, self._quickest_s
        return max(way_s / 2, shortest_s) if shortest_s < way_s < math.inf else math.inf

    @property
    def rest_of_backlog_s(self) -> float:
        """The longest time that the backlog waits for a live batch to go first, on a thin line [s]."""
        return self._part_s / 2

    @property
    def _stale_s(self) -> float:
        """Age at which an answer is stale, as far as that is known [s]."""
        return STALE_S if self.stale_s is None else self.stale_s

    @property
    def _quickest_s(self) -> float:
        """Time of the quickest request [s]; infinite before the first answer."""
        return min(self._least_s, self._former_s)

    @property
    def _part_s(self) -> float:
        return min(PART_S, PART_SHARE * self._stale_s)

    def _says_much(self, samples: int) -> bool:
        """Return whether the time of a request with so many samples says something about a large one."""
        return 2 * samples >= self.most


class _Slope:
    """Time that a further sample adds to a request: a line through the last few requests, by least squares."""

    KEPT = 0.8
    """Weight of a request over that of the next one: some five count."""
    SPREAD = 0.4
    """Least standard deviation of the sizes, over their mean, that shows a slope."""

    def __init__(self) -> None:
        self._weight = self._size = self._took_s = self._variance = self._covariance = 0.0

    def add(self, size: int, took_s: float) -> None:
        """Add a request."""
        self._weight = self.KEPT * self._weight + 1
        step, late_s = size - self._size, took_s - self._took_s
        self._size += step / self._weight
        self._took_s += late_s / self._weight
        self._variance = self.KEPT * self._variance + step * (size - self._size)
        self._covariance = self.KEPT * self._covariance + step * (took_s - self._took_s)

    @property
    def slope(self) -> float:
        """The time of a further sample [s]; infinite if sizes differ too little to show it."""
        if self._variance <= self._weight * (self.SPREAD * self._size) ** 2:
            return math.inf
        return max(0.0, self._covariance / self._variance)
