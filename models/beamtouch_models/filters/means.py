"""The filters: each takes a signal and a state, and returns the filtered signal and the next state.

A signal has shape (readings, 2, channels): the value in mm, and the variance of the white noise in it, relative to
that of a single reading. A state is a signal that holds the last rows.
"""

import math
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Scalar = TypeVar("Scalar", bound=np.generic)

SPIKE_MEMORY = 2
MIN_MM = 1e-9
"""Readings without noise are compared with this, so that rounding errors are neither a change nor motion."""
BEFORE = 3
"""Readings that decide which of the last ones are spikes."""
REPLACED = 3.0
"""Variance of a replaced reading.

It repeats one of its neighbours, so the noise of that one counts twice in a mean. In a mean of n readings, of which r
were replaced, the variance is (n - 2 r + 4 r) / n^2 = (n + 2 r) / n^2: as if each of the r had three times the
variance.
"""


class Stepped(NamedTuple):
    """What a filter makes of some readings."""

    signal: FloatArray
    """The filtered signal."""
    state: FloatArray
    """The next state."""


def fresh(rows: int, channels: int) -> FloatArray:
    """Return the initial state of a filter."""
    return np.full((rows, 2, channels), np.nan)


def signal_of(values: FloatArray) -> FloatArray:
    """Return readings, shape (readings, channels), as a signal."""
    signal = np.empty((len(values), 2, values.shape[1]))
    signal[:, 0] = values
    signal[:, 1] = np.where(np.isnan(values), np.nan, 1.0)
    return signal


def windows(rows: NDArray[Scalar], size: int) -> NDArray[Scalar]:
    """Return the last `size` rows up to each row that has as many, shape (windows, size, ...)."""
    count = len(rows) - size + 1
    return rows[np.newaxis] if count == 1 else rows[np.arange(count)[:, np.newaxis] + np.arange(size)]


def moving_average(signal: FloatArray, state: FloatArray, window: int, needed: int = 1) -> Stepped:
    """Average the last `window` readings; `state` holds the last `window` - 1.

    The standard deviation of white noise is divided by sqrt(window); a step is complete after `window` readings. At the
    start, and after a bad reading, the average is over the good readings in the window, or NaN if there are fewer than
    `needed`.
    """
    rows = np.concatenate([state, signal])
    parts = windows(rows, window)
    averaged: FloatArray = parts.sum(axis=1)
    if np.isnan(averaged).any():
        good = ~np.isnan(parts[:, :, 0])
        number = good.sum(axis=1)
        averaged = np.where(good[:, :, np.newaxis], parts, 0.0).sum(axis=1)
        averaged[np.isnan(signal) | (number < needed)[:, np.newaxis]] = np.nan
        averaged /= np.stack([number, number * number], axis=1)
    else:
        averaged /= np.array([[window], [window * window]])
    return Stepped(averaged, rows[len(rows) - (window - 1) :])


def spike(signal: FloatArray, state: FloatArray, limit_mm: float) -> Stepped:
    """Replace a reading further than `limit_mm` from the median of the last three by that median.

    `state` holds the last two unfiltered readings. A step passes one reading later, a single spike never passes, and
    noise below the limit passes unchanged. Nothing is replaced before three good readings in a row.
    """
    rows = np.concatenate([state, signal])
    oldest, older, newest = rows[:-2, 0], rows[1:-1, 0], rows[2:, 0]
    median = np.maximum(np.minimum(oldest, older), np.minimum(np.maximum(oldest, older), newest))
    replace = np.abs(newest - median) > limit_mm  # False where the median is NaN
    cleaned = signal.copy()
    np.copyto(cleaned[:, 0], median, where=replace)
    cleaned[:, 1][replace] *= REPLACED
    return Stepped(cleaned, rows[-SPIKE_MEMORY:])


def lone_spikes(values: FloatArray, spike_mm: float) -> tuple[NDArray[np.bool_], NDArray[np.bool_], FloatArray]:
    """Return which rows (rows,) are doubtful while they are the newest, which readings are spikes, and their medians.

    A spike is further than `spike_mm` from the median of itself and its neighbours, and the reading before it is not.
    The newest reading is doubtful if it is so far from the median of the last three. Medians have the shape of the
    values (rows, channels); the first two rows are never judged.
    """
    held, spikes, medians = np.zeros(len(values), dtype=np.bool_), np.zeros(values.shape, dtype=np.bool_), values
    # Where no reading is far from the one before it, none is far from a median of three.
    if math.isinf(spike_mm) or not (np.abs(values[1:] - values[:-1]) > spike_mm).any():
        return held, spikes, medians
    first, middle, last = values[:-2], values[1:-1], values[2:]
    medians = values.copy()
    medians[1:-1] = median = np.maximum(np.minimum(first, middle), np.minimum(np.maximum(first, middle), last))
    odd = np.abs(middle - median) > spike_mm  # False where the median is NaN
    # Readings that deviate one after the other are no lone spikes.
    spikes[2:-1] = odd[1:] & ~odd[:-1]
    held[2:] = ((np.abs(last - median) > spike_mm) & ~odd).any(axis=1)
    return held, spikes, medians
