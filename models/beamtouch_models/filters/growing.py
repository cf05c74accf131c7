"""The growing mean: the mean of all readings since the load last changed, found from the last `longest` readings.

It is Lepski's rule (Lepski 1991; Goldenshluger & Nemirovski 1997): the mean grows over windows as long as the newest
1, 2, 4, ... readings of each window agree with all of it. The reading that ends the growth is sought where the readings
before and after it differ most. If that change was sharp, the load has rested since, and all readings since count. If
not, something drifts: a drift that k readings just cannot show has moved their mean by several of its deviations, so
only a quarter of them counts, whose mean lags by an eighth of that against its noise.

docs/decisions/017-mean-since-touch.md explains the form and has the measurements.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beamtouch_models.filters.means import FloatArray
from beamtouch_models.filters.significance import chi_square_quantile

RATIO = 1.3
"""Between the lengths of windows; the split between two lengths is found to the reading."""
CHANGES = 0.002
"""Share of samples at rest in which some window of a size seems to hold a change."""
SHARP = 1e-6
"""Probability at rest of a difference between the last reading before a change and the mean since it."""
DRIFT_PART = 4
"""One reading in this many counts where something drifts."""
FINE = 2.0**16
"""Readings are rounded to this part of their noise, so that sums of them are exact however a stream is split."""
BEFORE = 3
"""Readings before the longest window that decide which of its readings are spikes."""


class Lengths(NamedTuple):
    """The windows that are compared."""

    windows: NDArray[np.intp]
    """Ascending, from 1 to the longest."""
    newest: NDArray[np.intp]
    """Places of 1, 2, 4, ... in them."""
    shorter: NDArray[np.bool_]
    """Whether a number of newest readings is less than a window, shape (windows, newest)."""


def lengths(longest: int) -> Lengths:
    """Return the windows up to `longest` readings."""
    powers = [2**power for power in range(longest.bit_length()) if 2**power <= longest]
    found = {*powers, longest}
    length = 1
    while length < longest:
        found.add(length)
        length = max(length + 1, int(length * RATIO))
    windows = np.array(sorted(found))
    newest = np.searchsorted(windows, powers[: max(1, len(powers))])
    return Lengths(windows, newest, windows[newest] < windows[:, np.newaxis])


class Sums(NamedTuple):
    """Sums of the readings before each row, so that the difference of two of them is the sum of the rows between."""

    values: FloatArray
    """In units of the noise over FINE, shape (rows + 1, channels)."""
    numbers: FloatArray | None
    """How many readings there are, of the same shape; None: as many as rows."""


def lone_spikes(values: FloatArray, spike_mm: float) -> tuple[NDArray[np.bool_], NDArray[np.bool_], FloatArray]:
    """Return which rows (rows,) are doubtful while they are the newest, which readings are spikes, and their medians.

    A spike is further than `spike_mm` from the median of itself and its neighbours, and the reading before it is not.
    The newest reading is doubtful if it is so far from the median of the last three. Medians have the shape of the
    values (rows, channels); the first two rows are never judged.
    """
    held, spikes, medians = np.zeros(len(values), dtype=np.bool_), np.zeros(values.shape, dtype=np.bool_), values
    if math.isinf(spike_mm):
        return held, spikes, medians
    first, middle, last = values[:-2], values[1:-1], values[2:]
    medians = values.copy()
    medians[1:-1] = median = np.maximum(np.minimum(first, middle), np.minimum(np.maximum(first, middle), last))
    odd = np.abs(middle - median) > spike_mm  # False where the median is NaN
    # Readings that deviate one after the other are no lone spikes.
    spikes[2:-1] = odd[1:] & ~odd[:-1]
    held[2:] = ((np.abs(last - median) > spike_mm) & ~odd).any(axis=1)
    return held, spikes, medians


class GrowingMean:
    """Finds the mean since the last change of the load.

    Parameters
    ----------
    longest
        Largest number of readings in a mean.
    unit_mm
        Standard deviation of a reading, shape (channels,); positive.
    spike_mm
        Distance from the median of three successive readings that makes the middle one a spike, and the newest one
        doubtful; None: all readings count.
    """

    def __init__(self, longest: int, unit_mm: FloatArray, spike_mm: float | None = None) -> None:
        self.memory = longest + BEFORE
        self._longest = longest
        self._quantum_mm = unit_mm / FINE
        self._spike_mm = math.inf if spike_mm is None else spike_mm
        self._lengths = lengths(longest)
        tests = max(1, len(self._lengths.newest))
        working = range(len(unit_mm) + 1)
        self._agree = np.array([chi_square_quantile(number, CHANGES / tests) for number in working]) * FINE**2
        self._sharp = np.array([chi_square_quantile(number, SHARP) for number in working]) * FINE**2
        spans = self._lengths.windows.astype(np.float64)
        inverse = 1 / spans
        with np.errstate(divide="ignore"):
            self._scale = np.where(
                self._lengths.shorter, 1 / (inverse[self._lengths.newest] - inverse[:, np.newaxis]), 0.0
            )

    def step(self, signal: FloatArray, state: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return means and their relative variance, and the next state: the last readings as they came."""
        rows = np.concatenate([state, signal])
        values = rows[:, 0]
        count = len(signal)
        whole = np.rint(values / self._quantum_mm)
        held, spikes, _ = lone_spikes(values, self._spike_mm)
        ends = np.arange(len(values) - count, len(values))
        # A doubtful reading waits for the next one, in all channels: a step moves them together.
        waits = held[ends]
        ends = ends - waits
        newest = whole[ends]
        whole[spikes] = np.nan
        newest[waits] = whole[ends[waits]]
        sums = _sums(whole)
        readings = self._readings(sums, ends, newest)
        total, number = _window(sums, ends, newest, readings)
        mean = np.full_like(newest, np.nan)
        np.divide(total, number, out=mean, where=number > 0)
        mean *= self._quantum_mm
        variance = np.full_like(mean, np.nan)
        np.divide(1.0, number, out=variance, where=number > 0)
        missing = np.isnan(signal[:, 0])
        mean[missing] = variance[missing] = np.nan
        return np.stack([mean, variance], axis=1), rows[len(rows) - self.memory :]

    def _readings(self, sums: Sums, ends: NDArray[np.intp], newest: FloatArray) -> NDArray[np.intp]:
        """Return how many rows up to each end are in its mean, shape (ends,)."""
        windows, places, shorter = self._lengths
        total, number = _window(sums, ends[:, np.newaxis], newest[:, np.newaxis], windows)
        if sums.numbers is None:
            means = total / number
            apart = means[:, np.newaxis, places] - means[:, :, np.newaxis]
            changed = (np.einsum("ewnc,ewnc->ewn", apart, apart) * self._scale > self._agree[-1]).any(axis=2)
        else:
            means = total / np.maximum(number, 1)
            few, many = number[:, np.newaxis, places], number[:, :, np.newaxis]
            tested = (few > 0) & (few < many)
            apart = means[:, np.newaxis, places] - means[:, :, np.newaxis]
            scale = np.where(tested, few * many / np.maximum(many - few, 1), 0.0)
            limits = self._agree[tested.sum(axis=3)]
            changed = (((apart * apart * scale).sum(axis=3) > limits) & shorter).any(axis=2)
        first = np.where(changed.any(axis=1), changed.argmax(axis=1), len(windows))
        found = np.full(len(ends), self._longest)
        for index in np.flatnonzero(first < len(windows)).tolist():
            reached, fails = int(windows[first[index] - 1]), int(windows[first[index]])
            found[index] = self._since(sums, int(ends[index]), newest[index], reached, fails)
        return found

    def _since(self, sums: Sums, end: int, newest: FloatArray, reached: int, fails: int) -> int:
        """Return how many rows count of a window that holds a change, where a window of `reached` rows holds none."""
        after = np.arange(max(1, reached // 2), fails)
        total, number = _window(sums, np.array(end), newest, np.append(after, fails))
        rest = number[-1] - number[:-1]
        since = total[:-1] / np.maximum(number[:-1], 1)
        before = (total[-1] - total[:-1]) / np.maximum(rest, 1)
        weight = number[:-1] * rest / np.maximum(number[-1], 1)
        place = int((((since - before) ** 2) * weight).sum(axis=1).argmax())
        size = int(after[place])
        last = sums.values[end - size + 1] - sums.values[end - size]
        there = np.broadcast_to(number[place] > 0, last.shape)
        if sums.numbers is not None:
            there = there & (sums.numbers[end - size + 1] > sums.numbers[end - size])
        apart = (last - since[place])[there]
        share = (1 + 1 / np.maximum(np.broadcast_to(number[place], last.shape), 1))[there]
        is_sharp = float((apart * apart / share).sum()) > self._sharp[len(apart)]
        return size if is_sharp else -(-size // DRIFT_PART)


def _sums(whole: FloatArray) -> Sums:
    """Return the sums of readings, shape (rows, channels); NaN is none."""
    values = np.zeros((len(whole) + 1, whole.shape[1]))
    good = ~np.isnan(whole)
    if good.all():
        np.cumsum(whole, axis=0, out=values[1:])
        return Sums(values, None)
    np.cumsum(np.where(good, whole, 0.0), axis=0, out=values[1:])
    numbers = np.zeros_like(values)
    np.cumsum(good, axis=0, out=numbers[1:])
    return Sums(values, numbers)


def _window(
    sums: Sums, ends: NDArray[np.intp], newest: FloatArray, sizes: NDArray[np.intp]
) -> tuple[FloatArray, FloatArray]:
    """Return sum and number of the readings in the last `sizes` rows up to `ends`; `newest` are the rows there."""
    starts = ends - sizes + 1
    good = ~np.isnan(newest)
    total = sums.values[ends] - sums.values[starts] + np.where(good, newest, 0.0)
    if sums.numbers is None:
        return total, sizes[..., np.newaxis].astype(np.float64)
    return total, sums.numbers[ends] - sums.numbers[starts] + good
