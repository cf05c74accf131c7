"""The readings that a filter looks back on: their sums, and which of them are spikes.

Readings have shape (readings, channels), oldest first; NaN is one that is lost, or not good.
"""

import math
from typing import NamedTuple, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Scalar = TypeVar("Scalar", bound=np.generic)

BEFORE = 3
"""Readings that decide which of the last ones are spikes."""
MAX_SUM = 2.0**50
"""Sums above it begin anew; those of 2**53 would not be exact."""


class Stream(NamedTuple):
    """Sums of the last rows of a stream, and numbers of the readings in them.

    New rows are written behind the end, in place. So an earlier state holds until the stream goes on from it.
    """

    before: FloatArray
    """Sums and numbers of all readings before each row, shape (rows, 2, channels). Sums of whole numbers are exact, so
    it does not matter where they began."""
    end: int
    """The row behind the last one that is known."""
    kept: int
    """Number of rows that are looked back on."""

    @classmethod
    def fresh(cls, kept: int, channels: int) -> Self:
        """Return a stream before its first reading."""
        return cls(np.zeros((kept, 2, channels)), kept, kept)

    def add(self, rows: FloatArray) -> Self:
        """Return the stream after more rows: values and numbers, shape (rows, 2, channels)."""
        before, end, lookback = self
        if end + len(rows) > len(before) or np.abs(before[end - 1]).max() > MAX_SUM:
            last = before[end - lookback : end]
            before, end = np.zeros((lookback + lookback // 4 + len(rows), *rows.shape[1:])), lookback
            np.subtract(last, last[0], out=before[:lookback])
        added = before[end : end + len(rows)]
        np.cumsum(rows, axis=0, out=added)
        added += before[end - 1]
        return self._replace(before=before, end=end + len(rows))


class Sums(NamedTuple):
    """Sums of the readings in some means."""

    before: FloatArray
    """As in `Stream`."""
    until: FloatArray
    """The same up to each mean, shape (means, 2, channels)."""
    starts: NDArray[np.intp]
    """The row after the last one in each mean, shape (means,)."""

    def of(self, at: NDArray[np.intp] | NDArray[np.bool_]) -> Self:
        """Return those of some of the means."""
        return self._replace(until=self.until[at], starts=self.starts[at])

    def since(self, ages: NDArray[np.intp]) -> FloatArray:
        """Return the sums of the last `ages` (means, n) rows of each mean, shape (means, n, 2, channels)."""
        # The newest reading is in no sum of the rows yet.
        rows = np.minimum(self.starts[:, np.newaxis] - ages, len(self.before) - 1)
        sums: FloatArray = self.until[:, np.newaxis] - self.before[rows]
        sums *= (ages > 0)[..., np.newaxis, np.newaxis]
        return sums

    def each(self, ages: NDArray[np.intp]) -> tuple[FloatArray, FloatArray]:
        """Return sums and numbers between successive `ages` (means, n), descending, both (means, n - 1, channels)."""
        since = self.since(ages)
        between = since[:, :-1] - since[:, 1:]
        return between[:, :, 0], between[:, :, 1]


def lone_spikes(readings: FloatArray, spike_mm: float) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return which rows (rows,) are doubtful while they are the newest, and which readings (rows, channels) are spikes.

    A spike is further than `spike_mm` from the median of itself and its neighbours, and the reading before it is not.
    The newest reading is doubtful if it is so far from the median of the last three. The first two rows are never
    judged.
    """
    doubtful, spikes = np.zeros(len(readings), dtype=np.bool_), np.zeros(readings.shape, dtype=np.bool_)
    # Where no reading is far from the one before it, none is far from a median of three.
    if math.isinf(spike_mm) or not (np.abs(readings[1:] - readings[:-1]) > spike_mm).any():
        return doubtful, spikes
    first, middle, last = readings[:-2], readings[1:-1], readings[2:]
    median = np.maximum(np.minimum(first, middle), np.minimum(np.maximum(first, middle), last))
    odd = np.abs(middle - median) > spike_mm  # False where the median is NaN
    # Readings that deviate one after the other are no lone spikes.
    spikes[2:-1] = odd[1:] & ~odd[:-1]
    doubtful[2:] = ((np.abs(last - median) > spike_mm) & ~odd).any(axis=1)
    return doubtful, spikes


def windows(rows: NDArray[Scalar], size: int, number: int) -> NDArray[Scalar]:
    """Return the last `size` rows up to each of the last `number` rows, shape (number, size, ...)."""
    windowed: NDArray[Scalar] = rows[len(rows) - number - size + 1 + np.arange(number)[:, np.newaxis] + np.arange(size)]
    return windowed
