"""Detection of means that move, from the scatter of their readings; `excess` has what each may be off by.

docs/decisions/012-covariance.md explains the form and has the measurements.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beamtouch_models.filters.excess import Evidence, Excess
from beamtouch_models.filters.lags import LAGS, drift_lags
from beamtouch_models.filters.means import MIN_MM, FloatArray, windows
from beamtouch_models.filters.significance import chi_square_quantile
from beamtouch_models.filters.touches import calm_readings, calm_since_touch, still_readings
from beamtouch_models.filters.view import Looks, Sizes, Tidied, View, decide

SCATTER_PART = 1 / 2
"""Part of the slowest period over which means scatter by their amplitude."""
LONE = 1
"""Readings in a window that may be replaced as spikes. More of them are the motion of the beam."""


class Past(NamedTuple):
    """The state: the last rows, shape (rows, channels), and whether the last mean moved."""

    readings: FloatArray
    cleaned: FloatArray
    """As they entered the mean."""
    means: FloatArray
    moved: bool


class Scatter:
    """Finds the means that move, and their excess covariance.

    Parameters
    ----------
    span
        Largest number of readings in a mean.
    slowest_period
        Period of the slowest motion, in readings; 0 if it is not known.
    noise_mm
        Standard deviation of a reading, shape (channels,).
    restarts
        Whether a mean may be of fewer readings than the last `span`, or of more.
    spike_mm
        Distance of a lone spike from the median, if the mean leaves out spikes itself; None: the readings arrive as
        they entered it.
    lag_readings
        Fewest newest readings whose distance from the mean counts as its lag; None: nothing does.
    """

    def __init__(
        self,
        span: int,
        slowest_period: float,
        noise_mm: FloatArray,
        *,
        restarts: bool = False,
        spike_mm: float | None = None,
        lag_readings: int | None = None,
    ) -> None:
        self._span = span
        self._still, self._calm = still_readings(slowest_period), calm_readings(slowest_period)
        half = max(1, math.ceil(SCATTER_PART * slowest_period))
        self._unit_mm = np.maximum(noise_mm, MIN_MM)
        self._looks = Looks(span, self._still, max(2 * span, half), self._unit_mm, lag_readings, restarts=restarts)
        self._rows = self._looks.rows
        self._means = max(span, half)
        self._restarts = restarts
        self._excess = Excess(noise_mm, self._unit_mm, half)
        self._spike_mm = spike_mm
        self._drift_limit = chi_square_quantile(len(noise_mm), LAGS)

    @property
    def memory(self) -> int:
        """Number of rows that are looked at."""
        return max(self._rows, self._means)

    def fresh(self, channels: int) -> Past:
        """Return the initial state."""
        rows = np.full((self._rows - 1, channels), np.nan)
        return Past(rows, rows, np.full((self._means, channels), np.nan), moved=False)

    def excess(
        self,
        readings: FloatArray,
        cleaned: FloatArray,
        mean: FloatArray,
        variance: FloatArray,
        drifts: NDArray[np.bool_] | None,
        past: Past,
    ) -> tuple[NDArray[np.bool_], NDArray[np.bool_], FloatArray, Past]:
        """Return which means move, which others lag, the excess covariance of both [mm^2], and the next state.

        Parameters
        ----------
        readings
            Unfiltered, shape (readings, channels).
        cleaned
            As they entered the mean.
        mean
            Means, NaN where a channel has none.
        variance
            Relative variance of their noise.
        drifts
            Which of them are of readings that drift; None: none is known to be.
        past
            The state.
        """
        rows, means = np.concatenate([past.readings, readings]), np.concatenate([past.means, mean])
        tidied = Tidied.of(rows, past.cleaned, cleaned, self._spike_mm)
        sizes = Sizes.of(variance, self._span, rows, restarts=self._restarts)
        moves, view, unfair, moved = self._moves(rows, tidied, mean, sizes, moved=past.moved)
        unproven = self._unproven(rows, mean, sizes)
        moves = moves | unproven
        lags = view.found.lags * self._unit_mm
        if drifts is not None and drifts.any():
            units = windows(tidied.rows, self._rows)[drifts] / self._unit_mm
            lags[drifts] = drift_lags(units, sizes.variance[drifts], self._drift_limit) * self._unit_mm
        lagging = lags.any(axis=1) & ~moves
        uncertain = moves | lagging
        excess = lags[uncertain, :, np.newaxis] * lags[uncertain, np.newaxis]
        moving = np.flatnonzero(moves)
        if len(moving):
            of = np.cumsum(uncertain)[moving] - 1
            excess[of] = self._of_moving(moving, mean, variance, means, sizes, view, unfair)
            if self._restarts:
                units = windows(rows, self._rows)[moving] / self._unit_mm
                sizes_there = np.rint(1 / sizes.variance[moving]).astype(np.intp)
                touches = calm_since_touch(units, sizes_there, self._still, self._calm)
                excess[of[touches]] = np.diag(self._unit_mm**2)
            # A beam that nobody has seen rest may swing as far as it is deflected.
            far_mm2 = (np.nan_to_num(mean[moving]) ** 2).sum(axis=1) * unproven[moving]
            excess[of] += far_mm2[:, np.newaxis, np.newaxis] * np.eye(mean.shape[1])
        kept = slice(len(rows) - self._rows + 1, None)
        return moves, lagging, excess, Past(rows[kept], tidied.rows[kept], means[len(means) - self._means :], moved)

    def _unproven(self, rows: FloatArray, mean: FloatArray, sizes: Sizes) -> NDArray[np.bool_]:
        """Return which means are of a deflected beam, and of too few readings to show that it rests, shape (means,).

        That is so when the readings begin, and after a gap that leaves nothing to look at.
        """
        compared = self._looks.compared(self._span)
        seen = np.concatenate([[0], np.cumsum((~np.isnan(rows)).any(axis=1))])
        known = np.maximum(seen[self._rows :] - seen[: -self._rows], sizes.readings)
        unproven: NDArray[np.bool_] = known < compared
        if unproven.any():
            square = np.nansum((mean / self._unit_mm) ** 2 / np.maximum(sizes.variance[:, np.newaxis], 1e-9), axis=1)
            unproven &= square > self._looks.look(self._span).newest[(~np.isnan(mean)).sum(axis=1)]
        return unproven

    def _of_moving(
        self,
        moving: NDArray[np.intp],
        mean: FloatArray,
        variance: FloatArray,
        means: FloatArray,
        sizes: Sizes,
        view: View,
        unfair: NDArray[np.bool_],
    ) -> FloatArray:
        """Return the excess of the means that move [mm^2], shape (moving, channels, channels)."""
        excess = np.empty((len(moving), mean.shape[1], mean.shape[1]))
        before = windows(means[:-1], self._means)
        kinds = np.array(sizes.spans)[moving]
        for span in set(kinds.tolist()):
            at = moving[kinds == span]
            evidence = Evidence(
                deviations=view.deviations[at],
                known=None if view.known is None else view.known[at],
                missing=None if view.missing is None else view.missing[at],
                before=before[at] - mean[at, np.newaxis],
                variance=variance[at],
                squares=view.found.squares[at],
                slopes=view.found.slopes[at],
                unfair=unfair[at],
            )
            look = self._looks.look(span)
            excess[kinds == span] = self._excess.of(evidence, span, self._looks.compared(span), look.newest)
        return excess

    def _moves(
        self, rows: FloatArray, tidied: Tidied, mean: FloatArray, sizes: Sizes, *, moved: bool
    ) -> tuple[NDArray[np.bool_], View, NDArray[np.bool_], bool]:
        """Return which means move, the readings that show it, which means are unfair, and whether the last one moved.

        A spike that is alone on a beam at rest is no motion, so the reading that took its place counts. While the beam
        moves, all readings count as they came.
        """
        clean, changed, newest = tidied
        absent: NDArray[np.bool_] = np.all(np.isnan(mean), axis=1)  # lost, or without a good channel
        spiky = bool(changed.any() or newest.any())
        raw = self._looks.view(windows(rows, self._rows), mean, sizes, moved=moved or spiky)
        moves = raw.found.moves
        if not spiky:
            if moved or moves.any():
                for index in np.flatnonzero(~absent).tolist():
                    moved = moves[index] = bool(moves[index] or (moved and raw.found.lingers[index]))
            return moves, raw, np.full(len(mean), self._restarts), moved
        window = windows(changed.astype(np.float64), self._rows)[:, -self._looks.compared(self._span) : -1]
        near = window.sum(axis=1) + newest
        if moved and (moves | raw.found.lingers).all():
            return np.ones(len(mean), dtype=np.bool_), raw, (near > 0) | self._restarts, moved
        replaced = windows(clean, self._rows).copy()
        replaced[:, -1] = rows[len(rows) - len(mean) :]  # what took the place of the newest reading may hide a touch
        tidy = self._looks.view(replaced, mean, sizes, moved=True)
        as_came = near > LONE
        moves, moved = decide(raw.found, tidy.found, as_came, newest, absent, moved=moved)
        return moves, raw.or_else(tidy, as_came), (as_came & (near > 0)) | self._restarts, moved
