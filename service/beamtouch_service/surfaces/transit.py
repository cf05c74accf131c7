"""How long a batch waited on its way, beyond the quickest batches of its sender. Pure: the caller gives the time."""

import math

from beamtouch_service.samples import Batch

WINDOW_S = 30.0
"""The quickest batch is that of the last one to two windows [s], in which two clocks drift apart by milliseconds."""


class Transit:
    """The batches of one surface on their way from the sender that sent the newest one.

    The clocks of sender and service have different origins, so the difference between receipt and sending means
    nothing by itself. It is least for a batch that did not wait: anything above it is time that the batch spent in a
    queue of a kernel or of a balancer, and that neither side can see.
    """

    def __init__(self) -> None:
        self._boot_id = ""
        self._least_s = self._former_s = math.inf
        """Least difference of the clocks in this window, and in the one before it."""
        self._ends_s = -math.inf
        """End of this window."""

    def waited_s(self, batch: Batch, received_s: float) -> float:
        """Return how long a batch that is read at `received_s` [s, monotonic] has waited [s]; 0 where it is unknown."""
        if batch.sent_us is None:
            return 0.0
        if batch.boot_id != self._boot_id or received_s > self._ends_s + WINDOW_S:
            self._boot_id, self._least_s, self._ends_s = batch.boot_id, math.inf, -math.inf
        if received_s > self._ends_s:
            self._former_s, self._least_s = self._least_s, math.inf
            self._ends_s = received_s + WINDOW_S
        apart_s = received_s - batch.sent_us / 1e6
        self._least_s = min(self._least_s, apart_s)
        return apart_s - min(self._least_s, self._former_s)
