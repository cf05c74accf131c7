"""The look at the newest readings: since when they agree, whether they drift, and how far a mean of them lags.

It is Lepski's rule (Lepski 1991; Goldenshluger & Nemirovski 1997): a window grows as long as its newest 1, 2, 4, ...
readings agree with all of it. The change that ends the growth is where the readings before and after it differ most. If
that was a step, the load has rested since, and all readings since agree. If not, something drifts. A drift just too
slow for k readings to show has moved their mean by several standard deviations. So only the newest quarter counts:
compared with its noise, its mean lags an eighth as much.

docs/decisions/017-mean-since-touch.md explains the form and has the measurements.
"""

import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beamtouch_models.filters.means import BEFORE, MIN_MM, FloatArray, lone_spikes
from beamtouch_models.filters.significance import FALSE, LAGS, SHARP, chi_square_quantile
from beamtouch_models.filters.splits import Sums, best_split, is_calm, is_sharp, is_step

OLDEST = (1, 4)
"""Numbers of oldest readings of a window that are compared with the others."""
RATIO = 1.3
"""Between the lengths of windows; the split between two lengths is found to the reading."""
DRIFT_PART = 4
"""One reading in this many counts where something drifts."""
LAG_NUMBERS = (1, 2, 4)
"""Numbers of newest readings whose distance from a long mean counts as its lag, in multiples of the least one."""
LEAST_LAG, LAG_PART = 8, 2
"""The least one, and its least multiple of the fewest readings. Fewer scatter too much to show a lag."""
STILL_PART = 1 / 4
"""Part of the slowest period in which readings must agree to prove rest."""
CALM_PART = 1.0
"""Part of the slowest period before a touch in which readings must be calm. A whole one shows the amplitude of a swing.
About a turning point, those of a part may agree, and if a period has few readings, the next one differs sharply."""
FINE = 2.0**16
"""Readings are rounded to this part of their noise, so that sums of them are exact however a stream is split."""
MAX_SUM = 2.0**50
"""Sums above it begin anew; those of 2**53 would not be exact."""
MAX_ROWS = 4096
"""Means whose splits are sought at once, so that they fit in memory."""


class Seen(NamedTuple):
    """What is seen at each reading."""

    since: NDArray[np.intp]
    """Number of rows since the newest change, shape (readings,); without the newest one if that is doubtful."""
    sizes: NDArray[np.intp]
    """Number of them that count, shape (readings,)."""
    mean_mm: FloatArray
    """Mean of them, shape (readings, channels); NaN for none, and if the newest one is missing."""
    number: FloatArray
    """How many readings of each channel they hold, of the same shape."""
    drifts: NDArray[np.bool_]
    """Whether they drift, shape (readings,); not if all rows before the change are lost, as it may be a step then."""
    doubtful: NDArray[np.bool_]
    """Whether the newest reading may be a spike, shape (readings,)."""
    touched: NDArray[np.bool_]
    """Whether they follow a touch: a sharp change of a beam that lay still, shape (readings,)."""
    lags_mm: FloatArray
    """Distance of their mean from the newest readings that noise does not explain, shape (readings, channels)."""


class Pairs(NamedTuple):
    """Pairs of windows whose means are compared: the newest readings of a window with all of it."""

    windows: NDArray[np.intp]
    """Lengths of the windows, ascending, from 1 to the longest."""
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
    most = 1
    for shorter, window in pairwise(windows):
        newest = {2**power for power in range(window.bit_length())}
        # What differs among the oldest readings hardly changes the mean of the newest ones.
        oldest = {shorter, *(window - few for few in OLDEST)}
        parts = sorted(part for part in newest | oldest if 0 < part < window)
        most = max(most, len(parts))
        pairs += [(part, window) for part in parts]
    needed = sorted({1, longest, *(length for pair in pairs for length in pair)})
    part, whole = np.array(pairs, dtype=np.intp).reshape(-1, 2).T
    places = np.searchsorted(needed, part), np.searchsorted(needed, whole)
    return Pairs(np.array(windows), np.array(needed), *places, most)


class Look:
    """Looks at the newest readings.

    Its state has shape (rows, 2, channels): for the last rows the sums and numbers of all readings before them, then
    the last BEFORE readings as they came, of which the newest is in no sum yet.

    Parameters
    ----------
    longest
        Largest number of readings that are looked at.
    unit_mm
        Standard deviation of a reading, shape (channels,); positive.
    spike_mm
        Distance from the median of three successive readings that makes the middle one a spike, and the newest one
        doubtful; inf: all readings count.
    fewest
        Smallest number of readings in a mean, except right after a touch. A beam that rings swings about its rest, so
        more readings are closer to it.
    slowest_period
        Period of the slowest motion, in readings; 0 if it is not known.
    """

    def __init__(
        self, longest: int, unit_mm: FloatArray, spike_mm: float, fewest: int = 1, slowest_period: float = 0.0
    ) -> None:
        self.longest, self.spike_mm = longest, spike_mm
        self._fewest = min(fewest, longest)
        self.still = math.ceil(STILL_PART * slowest_period)
        """Number of readings that must agree to prove rest."""
        self._before = max(2, math.ceil(CALM_PART * slowest_period))
        """Number of readings before a touch that must be calm."""
        self._numbers = max(LEAST_LAG, LAG_PART * self._fewest) * np.array(LAG_NUMBERS)
        self._quantum_mm = np.maximum(unit_mm, MIN_MM) / FINE
        self._pairs = pairs_of(longest)
        self._agree, self._sharp, self._clearly, self._lag = (
            FINE**2 * chi_square_quantile(len(unit_mm), beyond)
            for beyond in (FALSE / self._pairs.tests, SHARP, FALSE, LAGS)
        )
        self._calm = FINE**2 * np.array(
            [chi_square_quantile(few * (self._before - 1), FALSE) for few in range(len(unit_mm) + 1)]
        )

    def fresh(self, channels: int) -> FloatArray:
        """Return the initial state."""
        state = np.zeros((2 * self.longest + 2 * max(self._numbers) + self._before + BEFORE, 2, channels))
        state[-BEFORE:] = np.nan
        return state

    def step(self, readings: FloatArray, state: FloatArray, first: int = 0) -> tuple[Seen, FloatArray]:
        """Return what is seen at readings (readings, channels) from the `first` one on, and the next state."""
        count, kept = len(readings), len(state) - BEFORE
        values = np.concatenate([state[-BEFORE:, 0], readings])
        waits, spikes, _ = lone_spikes(values, self.spike_mm)
        counted = self._counted(values[BEFORE - 1 :])
        settled, newest, doubtful = counted[:-1], counted[1 + first :], waits[BEFORE + first :]
        if spikes.any():
            settled = np.where(spikes[BEFORE - 1 : -1, np.newaxis], 0.0, settled)
        before = state[:-BEFORE]
        # Sums of whole numbers are exact, so it does not matter where they began.
        if np.abs(before[-1]).max() > MAX_SUM:
            before = before - before[0]
        rows = np.concatenate([before, settled])
        rows[kept - 1 :] = np.cumsum(rows[kept - 1 :], axis=0)
        # A doubtful reading waits for the next one, in all channels: a step moves them together.
        starts = np.arange(kept + 1 + first, kept + 1 + count) - doubtful
        until = rows[kept + first :] + np.where(doubtful[:, np.newaxis, np.newaxis], 0.0, newest)
        sums = Sums(rows, until, starts)
        since, sizes, drifts, touched = self._sizes(sums)
        shown = drifts
        if drifts.any():
            before = sums.since(2 * since[:, np.newaxis]) - sums.since(since[:, np.newaxis])
            shown = drifts & before[:, 0, 1].any(axis=1)
        total, number = np.moveaxis(sums.since(sizes[:, np.newaxis])[:, 0], 1, 0)
        there = (number > 0) & (newest[:, 1] > 0)
        mean = np.where(there, total / np.maximum(number, 1), np.nan)
        lags = self._lags(sums, sizes, drifts) * self._quantum_mm
        following = np.concatenate([rows[count:], np.stack([values[-BEFORE:]] * 2, axis=1)])
        return Seen(since, sizes, mean * self._quantum_mm, number * there, shown, doubtful, touched, lags), following

    def _counted(self, values: FloatArray) -> FloatArray:
        """Return values (rows, channels) in parts of the noise, and their number: 0 for one that is missing."""
        there = ~np.isnan(values)
        counts = np.rint(np.where(there, values, 0.0) / self._quantum_mm)
        return np.stack([counts, there.astype(np.float64)], axis=1)

    def _sizes(self, sums: Sums) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.bool_], NDArray[np.bool_]]:
        """Return the rows since each change, how many count, whether they drift, and whether they follow a touch."""
        pairs = self._pairs
        since, sizes = np.full((2, len(sums.starts)), self.longest)
        drifts, touched = np.zeros((2, len(sizes)), dtype=np.bool_)
        changed = self._differ(sums)
        found = np.flatnonzero(changed.any(axis=1))
        for start in range(0, len(found), MAX_ROWS):
            at = found[start : start + MAX_ROWS]
            part, fails = sums.of(at), pairs.lengths[pairs.whole[changed[at].argmax(axis=1)]]
            # The windows before hold no change.
            reached = pairs.windows[np.searchsorted(pairs.windows, fails) - 1]
            split = best_split(part, np.maximum(1, reached // 2), fails)
            sharp = is_sharp(part, split, self._sharp)
            step = sharp | is_step(part, split, self._clearly)
            early = sharp & (split > 1) & (split < max(self._fewest, self.still))
            touched[at] = early & is_calm(part, split, self._before, self._calm)
            size = np.where(step, split, -(-split // DRIFT_PART))
            few = (size < self._fewest) & ~touched[at]
            since[at] = split
            sizes[at], drifts[at] = np.where(few, self._fewest, size), ~step | few
        return since, sizes, drifts, touched

    def _differ(self, sums: Sums) -> NDArray[np.bool_]:
        """Return which pairs of windows differ, shape (means, pairs)."""
        pairs = self._pairs
        total = sums.until[:, np.newaxis] - sums.rows[sums.starts[:, np.newaxis] - pairs.lengths]
        number = np.maximum(total[:, :, 1], 1e-9)  # windows without a reading differ from nothing
        means, inverse = total[:, :, 0] / number, 1 / number
        apart = means.take(pairs.part, axis=1) - means.take(pairs.whole, axis=1)
        variance = inverse.take(pairs.part, axis=1) - inverse.take(pairs.whole, axis=1)
        square = np.einsum("epc,epc,epc->ep", apart, apart, 1 / np.maximum(variance, 1e-9))
        changed: NDArray[np.bool_] = square > self._agree
        return changed

    def _lags(self, sums: Sums, sizes: NDArray[np.intp], drifts: NDArray[np.bool_]) -> FloatArray:
        """Return the lags of the means, shape (means, channels), in parts of the noise.

        A mean of many readings is so precise that a load which begins to move leaves its interval before any test can
        know. So numbers of newest readings are compared with it, and the part of their distance that noise does not
        explain is its lag. Readings that drift lag by half of the distance to as many readings before them.
        """
        ages = np.where(drifts[:, np.newaxis], 2 * sizes[:, np.newaxis], self._numbers)
        own, other = sums.since(sizes[:, np.newaxis]), sums.since(ages)
        other = np.where(drifts[:, np.newaxis, np.newaxis, np.newaxis], other - own, other)
        own_number, number = np.maximum(own[:, :, 1], 1), np.maximum(other[:, :, 1], 1)
        apart = other[:, :, 0] / number - own[:, :, 0] / own_number
        inverse = 1 / number + np.where(drifts[:, np.newaxis, np.newaxis], 1, -1) / own_number
        tested = (inverse > 0) & (other[:, :, 1] > 0) & (own[:, :, 1] > 0)
        square = np.where(tested, apart * apart / np.where(tested, inverse, 1.0), 0.0).sum(axis=2)
        best, at = square.argmax(axis=1), np.arange(len(sizes))
        part = np.sqrt(np.maximum(1 - self._lag / np.maximum(square[at, best], self._lag), 0.0))
        share = part * np.where(drifts, (sizes - 1) / (2 * sizes), 1.0)
        lags: FloatArray = np.where(tested[at, best], apart[at, best], 0.0) * share[:, np.newaxis]
        return lags
