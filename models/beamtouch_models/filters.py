"""Filters over deflections: pure functions of arrays, with the state handed in and out.

Values have shape (readings, channels), oldest first. The state of a filter holds the rows that it still needs, NaN
where there is nothing; `fresh` makes an empty one. The answer is the same, to the bit, for any split of the stream:
every value is computed from the same rows in the same order, and no sum runs on, so nothing drifts.

NaN stands for a reading of a channel that is not good. It gives NaN, and never touches a later value: a moving average
leaves it out and goes on with the good readings in its window, an adaptive mean too, and a low-pass starts anew at the
next good reading.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Step = Callable[[FloatArray, FloatArray], tuple[FloatArray, FloatArray]]
"""Takes values and state, returns filtered values and the state after them."""

SPIKE_MEMORY = 2
LOW_PASS_MEMORY = 1


def fresh(rows: int, channels: int) -> FloatArray:
    """Return the state of a filter that has seen nothing."""
    return np.full((rows, channels), np.nan)


def moving_average(
    values: FloatArray, state: FloatArray, window: int, needed: int = 1
) -> tuple[FloatArray, FloatArray]:
    """Average the last `window` readings; `state` holds the last `window` - 1.

    White noise comes out at 1/sqrt(window) of its standard deviation, a step is through after `window` readings. At the
    start, and after a bad reading, the average is over the good readings that the window holds; NaN where those are
    fewer than `needed`.
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

    White noise comes out at sqrt(a / (2 - a)) of its standard deviation, of a step (1 - a)**n remains after n readings.
    The first good reading is taken as it is.
    """
    smoothed = np.empty_like(values)
    last = state[0]
    for row, value in enumerate(values):
        last = np.where(np.isnan(last), value, last + factor * (value - last))
        smoothed[row] = last
    return smoothed, last[np.newaxis]


def spike(values: FloatArray, state: FloatArray, limit_mm: float) -> tuple[FloatArray, FloatArray]:
    """Replace a reading further than `limit_mm` from the median of the last three by that median.

    `state` holds the last two readings as they came. A step passes one reading later, a single spike never, and noise
    below the limit passes untouched. Until three good readings in a row are there, nothing is replaced.
    """
    rows = np.concatenate([state, values])
    oldest, older, newest = rows[:-2], rows[1:-1], rows[2:]
    median = np.maximum(np.minimum(oldest, older), np.minimum(np.maximum(oldest, older), newest))
    replace = np.abs(newest - median) > limit_mm  # False where the median is NaN
    return np.where(replace, median, newest), rows[-SPIKE_MEMORY:]


def adaptive(values: FloatArray, state: FloatArray, window: int, step_mm: float) -> tuple[FloatArray, FloatArray]:
    """Average the readings since the last step, at most `window` of them; the window is at least 2.

    A reading further than `step_mm` from the mean so far waits: its channel keeps that mean, and the next reading
    decides. If that one is as far the same way, it was a step, and the means of all channels begin anew with these two
    readings, so that all channels have equal noise. Else it was a spike, which never enters. If spikes are all that a
    window holds, the next reading is taken as it is.

    White noise comes out at 1/sqrt(n) of its standard deviation s, n being the readings since the step. A mean of n
    readings mistakes noise for a step where two readings in a row are far from it the same way; with k = `step_mm` / s,
    that happens less often, per reading and channel, than exp(-k^2 n / (n + 2)), as then the mean of the two, too, is
    further than `step_mm` from the mean of the n, and their difference has the variance s^2 (1/2 + 1/n).

    `state` holds the last `window` - 1 readings as they entered the mean, NaN before its beginning and where one waits
    or was left out, and in its last row the last reading as it came.
    """
    rows = np.concatenate([state[:-1], values])  # overwritten, reading by reading, with what enters
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
    """Return the mean of the good values of each column, NaN where there are none."""
    good = ~np.isnan(rows)
    number = good.sum(axis=0)
    total = np.where(good, rows, 0.0).sum(axis=0)
    mean = np.full(rows.shape[1], np.nan)
    np.divide(total, number, out=mean, where=number > 0)
    return mean


@dataclass(frozen=True)
class Stage:
    """One filter with its numbers filled in."""

    memory: int
    """Rows of state."""
    step: Step


class Chain:
    """Filters one after the other, and their state."""

    def __init__(self, chosen: tuple[Stage, ...], channels: int) -> None:
        self._stages = chosen
        self._channels = channels
        self.restart()

    def restart(self) -> None:
        """Forget everything, so that no value from before can reach one from after."""
        self._states = [fresh(stage.memory, self._channels) for stage in self._stages]

    def apply(self, values: FloatArray) -> FloatArray:
        """Return the filtered values, shape (readings, channels), and keep the state after them."""
        for index, stage in enumerate(self._stages):
            values, self._states[index] = stage.step(values, self._states[index])
        return values
