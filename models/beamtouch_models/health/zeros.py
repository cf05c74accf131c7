"""The zeros of the channels, from the rests before contacts. They need no contact, and no gain moves them."""

from dataclasses import dataclass

import numpy as np

from beamtouch_models.arrays import Floats
from beamtouch_models.health.contacts import SCATTER, BestSample
from beamtouch_models.health.history import History

NEWEST = 8
"""Contacts whose rests say where a zero is now."""
LEAST = 3
"""Contacts before which it must have been there."""
CERTAIN = 28.0
"""Square of a change over its variance that counts as certain, as for gains."""
EXACT_MM = 1e-7
"""Smallest standard deviation of a zero; a scene may state none."""
NORMAL = 1.959964
"""97.5 % quantile of the normal distribution."""


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
    return Estimate(value, value - NORMAL * deviation, value + NORMAL * deviation, changed)


def rest_block(sample: BestSample, offset_mm: Floats, zero_mm: Floats) -> tuple[Floats, Floats]:
    """Return weight and weighted sum of the rest before a contact, (channels,) each; 0 if it was not seen."""
    if sample.rest_mm is None or sample.rest_deviation_mm is None:
        return np.zeros(len(zero_mm)), np.zeros(len(zero_mm))
    weight: Floats = 1 / (np.square(sample.rest_deviation_mm) + (SCATTER * zero_mm) ** 2)
    return weight, weight * (np.array(sample.rest_mm) - offset_mm)


def zero_of(history: History, channel: int, zero_mm: float) -> tuple[Estimate, int] | None:
    """Return how the zero of a channel has changed, and the block with which it began; None if no rest was seen.

    A zero drifts by `zero_mm` (standard deviation) between two tares. What is within that is no change.
    """
    weight, total = history.since("rest_weight")[:, channel], history.since("rest_sum")[:, channel]
    if not weight[0] > 0:
        return None
    after = history.after()
    seen = weight > 0
    # Before the first contact the zero was where the tare put it, up to its drift.
    weight_before = weight[0] - weight + 1 / max(zero_mm, EXACT_MM) ** 2
    before = (total[0] - total) / weight_before
    mean = np.divide(total, weight, out=np.zeros_like(total), where=seen)
    variance = np.divide(1.0, weight, out=np.full_like(weight, np.inf), where=seen) + 1 / weight_before + zero_mm**2
    ratio = np.where(after >= LEAST, (mean - before) ** 2 / variance, 0.0)
    newest = _last(after, seen, min(NEWEST, max(1.0, after[0] / 2)))
    change = int(ratio.argmax())
    moved = mean[newest] - before[change]
    spread = 1 / weight[newest] + 1 / weight_before[change]
    certain = ratio[change] > CERTAIN and moved**2 > CERTAIN * (spread + zero_mm**2)
    if not certain:
        change = _last(after, seen, max(1.0, after[0] / 2))
        moved, spread = mean[newest] - before[change], 1 / weight[newest] + 1 / weight_before[change]
    return interval(float(moved), float(np.sqrt(spread)), changed=bool(certain)), change


def _last(after: Floats, seen: np.ndarray, contacts: float) -> int:
    """Return the last block with so many contacts from it on, and a rest."""
    return int(np.flatnonzero((after >= contacts) & seen)[-1])
