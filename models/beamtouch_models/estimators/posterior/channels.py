"""The smallest number of channels that determines a position."""

from itertools import combinations

from beamtouch_models.accuracy.limit import accuracy_limit
from beamtouch_models.accuracy.prior import Prior

ENOUGH = 0.5
"""A set of channels determines a position if its error is at most this share of the error of a guess without any."""
DRAWS = 512
MAX_SETS = 70
"""Up to this many sets of one size are all evaluated; of more, only sets of neighbours, which have the least
information."""


def fewest_channels(prior: Prior, seed: int) -> int:
    """Return the smallest number such that any set of as many channels determines a position.

    More channels never have less information, so the first sufficient number is the answer. All channels together
    always count as sufficient, because their answer comes with its interval.
    """
    # The mean distance from the median of a uniform distribution is a quarter of its range.
    guess_percent = (prior.position_mm[1] - prior.position_mm[0]) / 4 / prior.length_mm * 100
    every = range(prior.channels)
    for size in range(1, prior.channels):
        sets = list(combinations(every, size))
        if len(sets) > MAX_SETS:
            sets = [tuple(range(start, start + size)) for start in range(prior.channels - size + 1)]
        limits = (accuracy_limit(prior.without(*(set(every) - set(kept))), DRAWS, seed) for kept in sets)
        if all(limit.percent <= ENOUGH * guess_percent for limit in limits):
            return size
    return prior.channels
