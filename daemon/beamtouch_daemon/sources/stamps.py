"""Dates polled readings. Pure; no I/O.

A reading was taken between the request and the answer, so their middle is the best estimate. It is a good one only if
the answer came as soon as usual: on a busy machine, some take several times as long, and nothing says which way was
slow.
"""

import math
import statistics
from collections import deque

USUAL_OF = 20
"""Number of answers that say what is usual."""
LATE_SLOTS, LATE_PART = 0.1, 0.5
"""An answer is late that takes longer than usual by more than this part of the time between readings, or of the usual
duration, whichever is more."""


class Stamps:
    """Dates the readings of a source, `slot_s` apart."""

    def __init__(self, slot_s: float) -> None:
        self._slot_s = slot_s
        self._durations_s: deque[float] = deque(maxlen=USUAL_OF)

    def date(self, asked_s: float, answered_s: float) -> float:
        """Return when a reading was taken; NaN if its answer was late.

        Parameters
        ----------
        asked_s, answered_s : Times of the first request, and when the last answer had come or was given up.
        """
        took_s = answered_s - asked_s
        self._durations_s.append(took_s)
        usual_s = statistics.median(self._durations_s)
        is_late = took_s - usual_s > max(LATE_SLOTS * self._slot_s, LATE_PART * usual_s)
        return math.nan if is_late else asked_s + took_s / 2
