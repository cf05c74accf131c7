"""The samples of one boot that live batches bring; the backlog brings all others."""

import math
from time import monotonic

ENDED = 2**53
"""Greater than any sequence number."""


class LiveWindow:
    """The samples that live batches are bringing, and will bring."""

    def __init__(self) -> None:
        self.next = 1
        """Number of the first sample that no live batch has taken."""
        self.begun_s = -math.inf
        """Begin of the last live batch, on the monotonic clock."""
        self.sent_s = -math.inf
        """Time when it went out."""
        self._first_in_flight = set[int]()

    @property
    def first(self) -> int:
        """Number of the first sample that a live batch is bringing, or will bring."""
        return min([self.next, *self._first_in_flight])

    @property
    def in_flight(self) -> int:
        """Number of live batches without an answer."""
        return len(self._first_in_flight)

    def begin(self, first: int, last: int) -> None:
        """Note that a live batch brings samples, from now on."""
        self.begun_s = monotonic()
        self._first_in_flight.add(first)
        self.next = last + 1

    def end(self, first: int) -> None:
        """Note that a live batch is over, with an answer or without."""
        self._first_in_flight.discard(first)

    def restart(self) -> None:
        """Note that no live batch is in flight."""
        self._first_in_flight.clear()

    def close(self) -> None:
        """Leave all samples to the backlog."""
        self.next = ENDED
        self.restart()
