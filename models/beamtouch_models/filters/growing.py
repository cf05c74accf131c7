"""The growing mean: the mean of all readings since the load last changed, found from the last `longest` readings.

It is Lepski's rule (Lepski 1991; Goldenshluger & Nemirovski 1997): the mean grows over windows as long as the newest
1, 2, 4, ... readings of each window agree with all of it. The reading that ends the growth is sought where the readings
before and after it differ most. If that change was sharp, the load has rested since, and all readings since count. If
not, something drifts. A drift just too slow for k readings to show has moved their mean by several standard deviations.
So only the newest quarter counts: compared with its noise, its mean lags an eighth as much.

docs/decisions/017-mean-since-touch.md explains the form and has the measurements.
"""

import math

import numpy as np
from numpy.typing import NDArray

from beamtouch_models.filters.means import BEFORE, MIN_MM, FloatArray, Stepped, lone_spikes
from beamtouch_models.filters.pairs import differ, differ_of_full, pairs_of
from beamtouch_models.filters.significance import chi_square_quantile
from beamtouch_models.filters.splits import SHORT, Sums, best_split, is_sharp, is_step, parts, sharp_changes
from beamtouch_models.filters.touches import SHARP, calm_limit, calm_readings, follow_touch

CHANGES = 0.002
"""Share of samples at rest in which some window of a size seems to hold a change."""
CLEARLY = 1e-4
"""Quantile of the chi-square distribution by which a step must explain more than a slope does."""
DRIFT_PART = 4
"""One reading in this many counts where something drifts."""
NEVER = 2.0**40
"""Rows since the newest sharp change, if there was none."""
FINE = 2.0**16
"""Readings are rounded to this part of their noise, so that sums of them are exact however a stream is split."""
MAX_SUM = 2.0**50
"""Sums above it begin anew; those of 2**53 would not be exact."""


class GrowingMean:
    """Finds the mean since the last change of the load.

    Its state has shape (rows, 2, channels + 1): for the last rows the sums and numbers of all readings before them, and
    in the last column the number of rows since the newest sharp change; then the last BEFORE readings as they came, of
    which the newest is in no sum yet.

    Parameters
    ----------
    longest
        Largest number of readings in a mean.
    unit_mm
        Standard deviation of a reading, shape (channels,); positive.
    spike_mm
        Distance from the median of three successive readings that makes the middle one a spike, and the newest one
        doubtful; None: all readings count.
    fewest
        Smallest number of readings in a mean, except right after a sharp change of a beam that lay still. A beam that
        rings swings about its rest, so more readings are closer to it.
    slowest_period
        Period of the slowest motion, in readings; 0 if it is not known.
    """

    def __init__(
        self,
        longest: int,
        unit_mm: FloatArray,
        spike_mm: float | None = None,
        fewest: int = 1,
        slowest_period: float = 0.0,
    ) -> None:
        self._longest = longest
        self._fewest = min(fewest, longest)
        self._still = calm_readings(slowest_period)
        self._calm = calm_limit(self._still, len(unit_mm)) * FINE**2
        self._quantum_mm = np.maximum(unit_mm, MIN_MM) / FINE
        self._spike_mm = math.inf if spike_mm is None else spike_mm
        self._pairs = pairs_of(longest)
        working = range(len(unit_mm) + 1)
        alike = CHANGES / self._pairs.tests
        self._agree = np.array([chi_square_quantile(number, alike) for number in working]) * FINE**2
        self._sharp = np.array([chi_square_quantile(number, SHARP) for number in working]) * FINE**2
        self._may_be_sharp = math.sqrt(2 * self._sharp.min() / len(unit_mm))
        """A change of a single channel below which there is no sharp one, in parts of the noise."""
        self._clearly = chi_square_quantile(len(unit_mm), CLEARLY) * FINE**2
        self._inverse = 1 / self._pairs.lengths[:, np.newaxis]
        self._limits = self._agree[-1] * (self._inverse[self._pairs.part, 0] - self._inverse[self._pairs.whole, 0])
        """Of the squared distance between the means of each pair."""

    def fresh(self, channels: int) -> FloatArray:
        """Return the initial state."""
        state = np.zeros((2 * self._longest + self._fewest + self._still + BEFORE, 2, channels + 1))
        state[:, 0, -1] = NEVER
        state[-BEFORE:] = np.nan
        return state

    def step(self, signal: FloatArray, state: FloatArray) -> Stepped:
        """Return means and their relative variance, the next state, and which means drift."""
        if not len(signal):
            return Stepped(signal, state)
        count, kept = len(signal), len(state) - BEFORE
        values = np.concatenate([state[-BEFORE:, 0, :-1], signal[:, 0]])
        waits, spikes, _ = lone_spikes(values, self._spike_mm)
        counted = self._counted(values[BEFORE - 1 :])
        # A doubtful reading waits for the next one, in all channels: a step moves them together.
        at = np.arange(kept, kept + count)
        starts, last = at + 1, counted[1:]
        if waits.any():
            starts, last = starts - waits[BEFORE:], np.where(waits[BEFORE:, np.newaxis, np.newaxis], 0.0, last)
        settled = counted[:-1]
        if spikes.any():
            settled = np.where(spikes[BEFORE - 1 : -1, np.newaxis], 0.0, settled)
        following = self._following(state, settled)
        following[-BEFORE:, 0, :-1] = values[-BEFORE:]
        sums = following[:-BEFORE, :, :-1]
        until = sums[kept:] + last
        sizes, drifts = self._sizes(Sums(sums, until, starts), following[:-BEFORE, 0, -1])
        total = until - sums[starts - sizes]
        result = np.empty_like(total)
        there = (total[:, 1] > 0) & (counted[1:, 1] > 0)
        if there.all():
            np.divide(total[:, 0] * self._quantum_mm, total[:, 1], out=result[:, 0])
            np.divide(1.0, total[:, 1], out=result[:, 1])
        else:
            result[:] = np.nan
            np.divide(total[:, 0] * self._quantum_mm, total[:, 1], out=result[:, 0], where=there)
            np.divide(1.0, total[:, 1], out=result[:, 1], where=there)
        return Stepped(result, following[count:], drifts)

    def _counted(self, values: FloatArray) -> FloatArray:
        """Return values (rows, channels) in parts of the noise, and their number: 0 for one that is missing."""
        counted = np.ones((len(values), 2, values.shape[1]))
        np.divide(values, self._quantum_mm, out=counted[:, 0])
        np.rint(counted[:, 0], out=counted[:, 0])
        missing = np.isnan(counted[:, 0])
        if missing.any():
            counted[missing[:, np.newaxis].repeat(2, axis=1)] = 0.0
        return counted

    def _following(self, state: FloatArray, settled: FloatArray) -> FloatArray:
        """Return the state with rows after some readings (readings, 2, channels), before its last rows are known."""
        count, kept = len(settled), len(state) - BEFORE
        following = np.empty((len(state) + count, *state.shape[1:]))
        following[:kept] = state[:-BEFORE]
        sums, ages = following[:-BEFORE, :, :-1], following[:, 0, -1]
        # Sums of whole numbers are exact, so it does not matter where they began.
        if abs(sums[kept - 1].ravel()).max() > MAX_SUM:
            sums[:kept] -= state[0, :, :-1]
        np.cumsum(settled, axis=0, out=sums[kept:])
        sums[kept:] += sums[kept - 1]
        # The sums before a row are one row ahead of what is known of the row itself.
        each = np.concatenate([sums[kept - 1 : kept] - sums[kept - 2 : kept - 1], settled])
        index = np.arange(count)
        newest = np.full(count, -1.0 - ages[kept - 2])
        if abs(each[1:, 0] - each[:-1, 0]).max() > self._may_be_sharp:
            sharp = sharp_changes(each, self._sharp)
            newest = np.maximum.accumulate(np.where(sharp, index, newest))
        ages[kept - 1 : kept - 1 + count] = index - newest
        ages[kept - 1 + count] = NEVER  # not known before the next reading
        return following

    def _sizes(self, sums: Sums, ages: FloatArray) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
        """Return how many rows are in each mean, and whether they drift; `ages` (rows,) of the newest sharp changes."""
        needed, whole = self._pairs.lengths, self._pairs.whole
        total = sums.until[:, np.newaxis] - sums.rows[sums.starts[:, np.newaxis] - needed]
        lacking = total[:, -1, 1].min(axis=1) < self._longest
        if not lacking.any():
            changed = differ_of_full(self._pairs, total, self._inverse, self._limits)
        else:
            changed = np.empty((len(total), len(whole)), np.bool_)
            changed[lacking] = differ(self._pairs, total[lacking], self._agree)
            changed[~lacking] = differ_of_full(self._pairs, total[~lacking], self._inverse, self._limits)
        found, drifts = np.full(len(sums.starts), self._longest), np.zeros(len(sums.starts), dtype=np.bool_)
        at = np.flatnonzero(changed.any(axis=1))
        if len(at):
            fails = needed[whole[changed[at].argmax(axis=1)]]
            found[at], drifts[at] = self._since(sums.of(at), fails, ages)
        return found, drifts

    def _since(
        self, sums: Sums, fails: NDArray[np.intp], ages: FloatArray
    ) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
        """Return how many rows count of windows of `fails` rows that hold a change, and whether they drift.

        The windows before hold no change.
        """
        reached = self._pairs.windows[np.searchsorted(self._pairs.windows, fails) - 1]
        fewest = np.maximum(1, reached // 2)
        # The newest sharp change between two readings of the window.
        sizes = fewest + ages[sums.starts - fewest].astype(np.intp)
        drifts = np.zeros(len(sizes), dtype=np.bool_)
        for at in parts(np.flatnonzero((sizes >= fails) | (fails <= SHORT))):
            sought = sums.of(at)
            split = best_split(sought, fewest[at], fails[at])
            sharp = is_sharp(sought, split, self._sharp)
            unclear = np.flatnonzero(~sharp)
            if len(unclear):
                sharp[unclear] = is_step(sought.of(unclear), split[unclear], self._clearly)
            sizes[at], drifts[at] = np.where(sharp, split, -(-split // DRIFT_PART)), ~sharp
        few = np.flatnonzero(sizes < self._fewest)
        if len(few):
            touch = follow_touch(sums.of(few), sizes[few], self._still, self._sharp[-1], self._calm)
            sizes[few[~touch]], drifts[few] = self._fewest, ~touch
        return sizes, drifts
