"""Filters of deflections: pure functions of arrays that take a state and return the next one.

Values have shape (readings, channels), oldest first. The state of a filter contains the rows that it still needs, and
NaN for rows that do not exist yet; `fresh` returns an empty state. Any split of the stream gives the same result, to
the bit: every value is computed from the same rows in the same order. There are no running sums, so nothing drifts.

NaN marks a reading of a channel that is not good. Its result is NaN, and it never affects a later value: a moving
average and an adaptive mean continue with the good readings in the window, and a low-pass restarts at the next good
reading.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Step = Callable[[FloatArray, FloatArray], tuple[FloatArray, FloatArray]]
"""Takes values and a state; returns filtered values and the next state."""

SPIKE_MEMORY = 2
LOW_PASS_MEMORY = 1


def fresh(rows: int, channels: int) -> FloatArray:
    """Return the initial state of a filter."""
    return np.full((rows, channels), np.nan)


def moving_average(
    values: FloatArray, state: FloatArray, window: int, needed: int = 1
) -> tuple[FloatArray, FloatArray]:
    """Average the last `window` readings; `state` holds the last `window` - 1.

    The standard deviation of white noise is divided by sqrt(window); a step is complete after `window` readings. At the
    start, and after a bad reading, the average is over the good readings in the window, or NaN if there are fewer than
    `needed`.
    """
    rows = np.concatenate([state, values])
    count = len(values)
    total = np.zeros_like(values)
    good = np.zeros_like(values)
    for first in range(window):
        part = rows[first : first + count]
        is_good = ~np.isnan(part)
        total += np.where(is_good, part, 0.0)
        good += is_good
    averaged = np.full_like(values, np.nan)
    np.divide(total, good, out=averaged, where=~np.isnan(values) & (good >= needed))
    return averaged, rows[len(rows) - (window - 1) :]


def smoothing(cutoff_hz: float, rate_hz: float) -> float:
    """Return the factor `a` of `low_pass` that puts its -3 dB point at `cutoff_hz`."""
    return 1.0 - math.exp(-2.0 * math.pi * cutoff_hz / rate_hz)


def low_pass(values: FloatArray, state: FloatArray, factor: float) -> tuple[FloatArray, FloatArray]:
    """Apply y += a (x - y) with a = `factor`; `state` holds the last y.

    The standard deviation of white noise is multiplied by sqrt(a / (2 - a)). After n readings, (1 - a)**n of a step
    remains. The first good reading passes unchanged.
    """
    smoothed = np.empty_like(values)
    last = state[0]
    for row, value in enumerate(values):
        last = np.where(np.isnan(last), value, last + factor * (value - last))
        smoothed[row] = last
    return smoothed, last[np.newaxis]


def spike(values: FloatArray, state: FloatArray, limit_mm: float) -> tuple[FloatArray, FloatArray]:
    """Replace a reading further than `limit_mm` from the median of the last three by that median.

    `state` holds the last two unfiltered readings. A step passes one reading later, a single spike never passes, and
    noise below the limit passes unchanged. Nothing is replaced before three good readings in a row.
    """
    rows = np.concatenate([state, values])
    oldest, older, newest = rows[:-2], rows[1:-1], rows[2:]
    median = np.maximum(np.minimum(oldest, older), np.minimum(np.maximum(oldest, older), newest))
    replace = np.abs(newest - median) > limit_mm  # False where the median is NaN
    return np.where(replace, median, newest), rows[-SPIKE_MEMORY:]


def adaptive(values: FloatArray, state: FloatArray, window: int, step_mm: float) -> tuple[FloatArray, FloatArray]:
    """Average the readings since the last step, at most `window` of them; the window is at least 2.

    A reading further than `step_mm` from the mean is held back: its channel keeps the mean, and the next reading
    decides. If the next one is as far in the same direction, it was a step, and the means of all channels restart with
    these two readings, so that all channels have equal noise. Otherwise it was a spike, which never enters the mean. If
    a window contains nothing but spikes, the next reading passes unchanged.

    The standard deviation s of white noise is divided by sqrt(n), with n readings since the step. Noise looks like a
    step if two readings in a row are far from the mean in the same direction. With k = `step_mm` / s, the probability
    per reading and channel is below exp(-k^2 n / (n + 2)): the mean of the two readings is then also further than
    `step_mm` from the mean of the n, and their difference has the variance s^2 (1/2 + 1/n).

    `state` holds the last `window` - 1 readings as they entered the mean: NaN before its start, and for readings that
    are held back or left out. Its last row is the last unfiltered reading.
    """
    rows = np.concatenate([state[:-1], values])  # overwritten with the readings that enter the mean
    newest = state[-1]
    averaged = np.empty_like(values)
    for row, value in enumerate(values):
        end = row + window - 1
        before = _mean(rows[row:end])
        far = np.abs(value - before) > step_mm  # False where either is NaN
        waited = np.isnan(rows[end - 1]) & (np.abs(newest - before) > step_mm)
        if np.any(far & waited & ((value > before) == (newest > before))):
            rows[row : end - 1] = np.nan
            rows[end - 1] = newest
            far[:] = False
        rows[end] = np.where(far, np.nan, value)
        averaged[row] = np.where(np.isnan(value), np.nan, np.where(far, before, _mean(rows[row : end + 1])))
        newest = value
    return averaged, np.concatenate([rows[len(values) :], newest[np.newaxis]])


def _mean(rows: FloatArray) -> FloatArray:
    """Return the mean of the good values of each column, NaN if there are none."""
    good = ~np.isnan(rows)
    number = good.sum(axis=0)
    total = np.where(good, rows, 0.0).sum(axis=0)
    mean = np.full(rows.shape[1], np.nan)
    np.divide(total, number, out=mean, where=number > 0)
    return mean


@dataclass(frozen=True)
class Stage:
    """One filter with its parameters."""

    memory: int
    """Number of rows of its state."""
    step: Step


class Chain:
    """Several filters in succession, and their states."""

    def __init__(self, chosen: tuple[Stage, ...], channels: int) -> None:
        self._stages = chosen
        self._channels = channels
        self.restart()

    def restart(self) -> None:
        """Reset all states, so that no earlier value affects a later one."""
        self._states = [fresh(stage.memory, self._channels) for stage in self._stages]

    def apply(self, values: FloatArray) -> FloatArray:
        """Return the filtered values, shape (readings, channels), and keep the state after them."""
        for index, stage in enumerate(self._stages):
            values, self._states[index] = stage.step(values, self._states[index])
        return values
