"""How long a batch waited on its way, beyond the quickest batches of its sender. Pure: the caller gives the time."""

import math
from collections import OrderedDict

from beamtouch_service.samples import Batch
from beamtouch_service.surfaces.sequence_log import MAX_SENDERS

WINDOW_S = 30.0
"""The quickest batch is that of the last one to two windows [s] with batches."""
MAX_DRIFT = 200e-6
"""Two clocks drift apart by at most this part of the time; each is right to 100 ppm."""


class Transit:
    """The batches of one surface on their way from each of its senders, for a bounded number of senders."""

    def __init__(self) -> None:
        self._ways: OrderedDict[str, _Way] = OrderedDict()

    def waited_s(self, batch: Batch, received_s: float) -> float:
        """Return how long a batch that is read at `received_s` [s, monotonic] has waited [s]; 0 where it is unknown."""
        if batch.sent_us is None:
            return 0.0
        way = self._ways.setdefault(batch.boot_id, _Way())
        self._ways.move_to_end(batch.boot_id)
        if len(self._ways) > MAX_SENDERS:
            self._ways.popitem(last=False)
        return way.waited_s(received_s - batch.sent_us / 1e6, received_s)


class _Way:
    """The batches of one sender.

    The clocks of sender and service have different origins, so the difference between receipt and sending means
    nothing by itself. It is least for a batch that did not wait: anything above it is time that the batch spent in a
    queue of a kernel or of a balancer, and that neither side can see.
    """

    def __init__(self) -> None:
        self._least_s = self._former_s = math.inf
        """Least difference of the clocks in this window, and in the one before it."""
        self._ends_s = -math.inf
        """End of this window."""

    def waited_s(self, apart_s: float, received_s: float) -> float:
        """Return how long a batch has waited [s], from the difference between its receipt and its sending [s]."""
        if received_s > self._ends_s:
            # After an outage, the first batch may have been held during all of it. So the quickest before still counts.
            self._former_s = self._least_s + MAX_DRIFT * (received_s - self._ends_s)
            self._least_s, self._ends_s = math.inf, received_s + WINDOW_S
        self._least_s = min(self._least_s, apart_s)
        return apart_s - min(self._least_s, self._former_s)
