"""With how few channels a position is still determined."""

from itertools import combinations

from beamtouch_models.limit import accuracy_limit
from beamtouch_models.prior import Prior

ENOUGH = 0.5
"""A set of channels determines a position if it at least halves the error that a guess without any would make."""
DRAWS = 512
MOST_SETS = 70
"""Sets of one size that are all looked at; of more, those of neighbouring channels, which know the least."""


def fewest_channels(prior: Prior, seed: int) -> int:
    """Return the smallest number of channels any so many of which determine a position.

    More channels never know less, so the first number that serves is the answer. All channels together count as
    enough, however little they know: what they say comes with its interval.
    """
    # The median of an even distribution is a quarter of its range away on average.
    guess_percent = (prior.position_mm[1] - prior.position_mm[0]) / 4 / prior.length_mm * 100
    every = range(prior.channels)
    for size in range(1, prior.channels):
        sets = list(combinations(every, size))
        if len(sets) > MOST_SETS:
            sets = [tuple(range(start, start + size)) for start in range(prior.channels - size + 1)]
        limits = (accuracy_limit(prior.without(*(set(every) - set(kept))), DRAWS, seed) for kept in sets)
        if all(limit.percent <= ENOUGH * guess_percent for limit in limits):
            return size
    return prior.channels
