"""Pairs of windows whose means a growing mean compares."""

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beamtouch_models.filters.means import FloatArray

OLDEST = (1, 4)
"""Numbers of oldest readings of a window that are compared with the others."""
RATIO = 1.3
"""Between the lengths of windows; the split between two lengths is found to the reading."""


class Pairs(NamedTuple):
    """Pairs of windows whose means are compared: the newest readings of a window with all of it."""

    windows: NDArray[np.intp]
    """Lengths of the windows that a mean may have, ascending, from 1 to the longest."""
    lengths: NDArray[np.intp]
    """All lengths whose means are needed."""
    part: NDArray[np.intp]
    """Place of the shorter one of each pair in `lengths`."""
    whole: NDArray[np.intp]
    """Place of the longer one, ascending."""
    tests: int
    """Largest number of pairs with the same window."""


def pairs_of(longest: int) -> Pairs:
    """Return the pairs up to `longest` readings."""
    windows = [1]
    while windows[-1] < longest:
        windows.append(min(longest, max(windows[-1] + 1, int(windows[-1] * RATIO))))
    pairs: list[tuple[int, int]] = []
    for shorter, window in pairwise(windows):
        newest = {2**power for power in range(window.bit_length())}
        # What differs among the oldest readings hardly changes the mean of the newest ones.
        oldest = {shorter, *(window - few for few in OLDEST)}
        pairs += [(part, window) for part in sorted(newest | oldest) if 0 < part < window]
    needed = sorted({1, longest, *(length for pair in pairs for length in pair)})
    part, whole = np.array(pairs, dtype=np.intp).reshape(-1, 2).T
    most = max((sum(window == other for _, other in pairs) for window in windows), default=1)
    return Pairs(
        np.array(windows),
        np.array(needed),
        np.searchsorted(needed, part),
        np.searchsorted(needed, whole),
        max(1, most),
    )


def differ(pairs: Pairs, total: FloatArray, limits: FloatArray) -> NDArray[np.bool_]:
    """Return which pairs differ, (means, pairs), where some windows lack readings.

    The sums and numbers of the readings in the windows, `total`, have shape (means, lengths, 2, channels). The limits
    of the squares are by the number of channels, as if readings had a deviation of 1.
    """
    number = total[:, :, 1]
    means = total[:, :, 0] / np.maximum(number, 1)
    few, many = number.take(pairs.part, axis=1), number.take(pairs.whole, axis=1)
    tested = (few > 0) & (few < many)
    apart = means.take(pairs.part, axis=1) - means.take(pairs.whole, axis=1)
    scale = np.where(tested, few * many / np.maximum(many - few, 1), 0.0)
    square, working = np.einsum("epc,epc,epc->ep", apart, apart, scale), np.einsum("epc->ep", tested, dtype=np.intp)
    changed: NDArray[np.bool_] = square > limits[working]
    return changed


def differ_of_full(pairs: Pairs, total: FloatArray, inverse: FloatArray, limits: FloatArray) -> NDArray[np.bool_]:
    """Return which pairs differ, (means, pairs), where no window lacks a reading.

    The sums and numbers of the readings, `total`, are as in `differ`; `inverse` is one over the lengths, of shape
    (lengths, 1). The limits (pairs,) are those of the squared distances.
    """
    means = total[:, :, 0] * inverse
    apart = means.take(pairs.part, axis=1) - means.take(pairs.whole, axis=1)
    changed: NDArray[np.bool_] = np.einsum("epc,epc->ep", apart, apart) > limits
    return changed
