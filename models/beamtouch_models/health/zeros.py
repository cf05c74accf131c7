"""The zeros of the channels, from the rests before contacts. They need no contact, and no gain moves them."""

from dataclasses import dataclass

import numpy as np

from beamtouch_models.arrays import Bools, Floats
from beamtouch_models.error_model import NORMAL_975
from beamtouch_models.health.history import History

NEWEST = 8
"""Newest contacts, whose rests give the present zero."""
MIN_CONTACTS = 3
"""Fewest contacts since a change."""
DRIFT = 4.0
"""A zero that moved by less than this many standard deviations of the stated drift has not changed."""
CERTAIN = 28.0
"""Square of the move beyond that, over its variance, above which a change is certain."""
EXACT_MM = 1e-7
"""Smallest standard deviation of a zero; a scene may state none."""


@dataclass(frozen=True)
class Estimate:
    """A change with its 95 % interval."""

    value: float
    low: float
    high: float
    changed: bool
    """Whether the change is certain."""


def interval(value: float, deviation: float, *, changed: bool) -> Estimate:
    """Return a change with its interval."""
    return Estimate(value, value - NORMAL_975 * deviation, value + NORMAL_975 * deviation, changed)


def zero_of(history: History, channel: int, zero_mm: float) -> tuple[Estimate, int] | None:
    """Return how the zero of a channel has changed, and the block with which it began; None if no rest was seen.

    A zero drifts by `zero_mm` (standard deviation) after a tare.
    """
    weight, total = history.since("rest_weight")[:, channel], history.since("rest_sum")[:, channel]
    if not weight[0] > 0:
        return None
    after, seen = history.after(), weight > 0
    # Before the first contact the zero was where the tare put it, up to its drift.
    weight_before = weight[0] - weight + 1 / max(zero_mm, EXACT_MM) ** 2
    before = (total[0] - total) / weight_before
    mean = np.divide(total, weight, out=np.zeros_like(total), where=seen)
    variance = np.divide(1.0, weight, out=np.full_like(weight, np.inf), where=seen)
    ratio = np.where(after >= MIN_CONTACTS, _beyond(mean - before, zero_mm) ** 2 / (variance + 1 / weight_before), 0.0)
    change, newest = int(ratio.argmax()), _last(after, seen, min(NEWEST, after[0] / 2))

    def moved(first: int) -> tuple[float, float]:
        """Return how far the zero is now from where it was before a block, with its variance."""
        return float(mean[newest] - before[first]), float(variance[newest] + 1 / weight_before[first])

    # A zero that creeps has moved before it is seen to: it is compared with the first half of what was before.
    value, spread = moved(_last(after, seen, (after[0] + after[change]) / 2))
    if min(ratio[change], _beyond(np.array(value), zero_mm) ** 2 / spread) > CERTAIN:
        return interval(value, spread**0.5, changed=True), change
    half = _last(after, seen, after[0] / 2)
    value, spread = moved(half)
    return interval(value, spread**0.5, changed=False), half


def _beyond(moved_mm: Floats, zero_mm: float) -> Floats:
    """Return how far changes exceed the drift."""
    beyond: Floats = np.maximum(np.abs(moved_mm) - DRIFT * zero_mm, 0.0)
    return beyond


def _last(after: Floats, seen: Bools, contacts: float) -> int:
    """Return the last block with a rest and at least this many contacts from it on."""
    return int(np.flatnonzero((after >= contacts) & seen)[-1])
