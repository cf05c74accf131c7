"""Arrival times of batches, as far as neither side can see them, and the times at which samples were taken.

Pure: the caller gives the time in seconds. A batch may wait twice: in a queue of a kernel or of a balancer on its path,
and before a service that stands still. A doubt makes its samples older, but for one that only time could resolve: of a
wait on the path, `MAX_DRIFT` of the time without batches before it may stay unseen (decision 002).
"""

import math
from collections import OrderedDict
from typing import NamedTuple

from beamtouch_service.samples import Batch, Sample
from beamtouch_service.surfaces.order import MAX_SENDERS

WINDOW_S = 30.0
"""The quickest batch is that of the last one to two windows [s] with batches."""
MAX_DRIFT = 200e-6
"""Two clocks drift apart by at most this part of the time; each is right to 100 ppm."""
TICK_S = 0.05
"""The service notes this often that it does not stand still [s]."""
PAUSE_S = 0.1
"""If it has not done so for longer [s], requests may have waited for it."""
CATCH_UP_S = 0.5
"""After a pause [s], what had waited is still being read."""


class StallDetector:
    """Notices that the process stood still, or was busy for long: the kernel kept what arrived meanwhile."""

    def __init__(self) -> None:
        self._last_s: float | None = None
        """None before the first tick: nothing has waited yet."""
        self._before_pause_s = self._caught_up_s = -math.inf

    def tick(self, now_s: float) -> None:
        """Note that the process runs at `now_s` [s]."""
        last_s, self._last_s = self._last_s, now_s
        if last_s is None or now_s - last_s <= PAUSE_S:
            return
        if last_s > self._caught_up_s:
            self._before_pause_s = last_s
        self._caught_up_s = now_s + CATCH_UP_S

    def earliest_s(self, now_s: float) -> float:
        """Return the earliest time [s] at which what is read at `now_s` may have arrived."""
        if self._last_s is None:
            return now_s
        if now_s <= self._caught_up_s:
            return self._before_pause_s
        return now_s if now_s - self._last_s <= PAUSE_S else self._last_s


class Transit:
    """The batches of one surface on their way from each of its senders, for a bounded number of senders."""

    def __init__(self) -> None:
        self._paths: OrderedDict[str, _Path] = OrderedDict()

    def arrival_s(self, batch: Batch, read_s: float, earliest_s: float) -> float:
        """Return the time at which a batch counts as arrived [s].

        Parameters
        ----------
        batch
            States when it was sent, by the clock of its sender.
        read_s
            Time at which its head is read [s].
        earliest_s
            Earliest time at which it may have been there [s]; it counts where the path of the sender is not known yet.
        """
        if batch.backlog or batch.sent_us is None:
            return earliest_s
        path = self._paths.get(batch.boot_id)
        if path is None:
            if earliest_s < read_s:
                # It may have waited, so it cannot be the quickest.
                return earliest_s
            path = self._paths[batch.boot_id] = _Path()
            if len(self._paths) > MAX_SENDERS:
                self._paths.popitem(last=False)
        self._paths.move_to_end(batch.boot_id)
        return read_s - path.waited_s(read_s - batch.sent_us / 1e6, read_s)


class _Path:
    """The batches of one sender.

    The clocks of sender and service have different origins, so the difference between receipt and sending means
    nothing by itself. It is least for a batch that did not wait: anything above it is time that the batch spent in a
    queue that neither side can see.
    """

    def __init__(self) -> None:
        self._least_s = self._former_s = math.inf
        """Least difference of the clocks in this window, and in the one before it."""
        self._ends_s = -math.inf
        """End of this window."""

    def waited_s(self, clock_difference_s: float, received_s: float) -> float:
        """Return how long a batch has waited [s], from the difference between its receipt and its sending [s]."""
        if received_s > self._ends_s:
            # After an outage, the first batch may have been held during all of it. So the quickest before still counts.
            self._former_s = self._least_s + MAX_DRIFT * (received_s - self._ends_s)
            self._least_s, self._ends_s = math.inf, received_s + WINDOW_S
        self._least_s = min(self._least_s, clock_difference_s)
        return clock_difference_s - min(self._least_s, self._former_s)


class Moment(NamedTuple):
    """The time of a sample."""

    taken_s: float
    """[s, monotonic]; never before the sample before."""
    passed_s: float
    """Time since the sample before, as far as it counts [s]."""


class SampleClock:
    """Tells when samples were taken, by the ages that batches state."""

    def __init__(self, max_pause_s: float) -> None:
        """Count at most `max_pause_s` between two samples: nothing is known of a surface in a longer pause."""
        self._max_pause_s = max_pause_s
        self._last_s = 0.0

    def tell(self, samples: list[Sample], acquired_s: float) -> list[Moment]:
        """Return when the next samples were taken, the last one at `acquired_s` [s, monotonic]."""
        return [self._tell(sample, samples[-1], acquired_s) for sample in samples]

    def _tell(self, sample: Sample, newest: Sample, acquired_s: float) -> Moment:
        # No sample is newer than the newest one, whatever happened to the sender's wall clock. The ages of two batches
        # differ by how long each travelled: no time counts twice.
        before_newest_s = max(0, newest.acquired_unix_us - sample.acquired_unix_us) / 1e6
        taken_s = max(self._last_s, acquired_s - before_newest_s)
        passed_s, self._last_s = min(taken_s - self._last_s, self._max_pause_s), taken_s
        return Moment(taken_s, passed_s)
