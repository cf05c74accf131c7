"""The covariance of a mean beyond that of white noise: from the scatter of its readings and of the means before it.

docs/decisions/012-covariance.md explains the form and has the measurements.
"""

import math

import numpy as np
from numpy.typing import NDArray

from beamtouch_models.filters.means import FloatArray, windows
from beamtouch_models.filters.significance import Look, look_at

SMALLEST_NOISE_MM = 1e-9
"""Readings without noise are compared with this, so that rounding errors are no motion."""
STILL_PART = 1 / 4
"""Part of the slowest period in which readings must agree to prove rest."""
SCATTER_PART = 1 / 2
"""Part of the slowest period over which means scatter by their amplitude."""
USUAL = 1.5
"""The newest reading deviates from the mean as usual if its square is within this many times the scatter before the
mean; that of a vibration is on average once and at most twice it."""
UNSEEN = 0.01
"""Vibrations that the readings do not show, relative to those that they show: modes that swing as fast as the readings
come seem to stand still."""

Past = tuple[FloatArray, FloatArray]
"""The last readings as they entered the mean, and the last means, shape (rows, channels)."""


class Scatter:
    """Finds the excess covariance.

    Parameters
    ----------
    span
        Largest number of readings in a mean.
    slowest_period
        Period of the slowest motion, in readings; 0 if it is not known.
    noise_mm
        Standard deviation of a reading, shape (channels,).
    """

    def __init__(self, span: int, slowest_period: float, noise_mm: FloatArray) -> None:
        self.span = span
        self._still = math.ceil(STILL_PART * slowest_period)
        self._half = max(1, math.ceil(SCATTER_PART * slowest_period))
        self._noise_mm = noise_mm
        self._identity = np.eye(len(noise_mm))
        self._unit_mm = np.maximum(noise_mm, SMALLEST_NOISE_MM)
        self._slope = max(2 * span, self._half)
        self._rows = max(self._slope, span + self._compared(span))
        self._means = max(span, self._half)

    @property
    def memory(self) -> int:
        """Number of rows that are looked at."""
        return max(self._rows, self._means)

    def fresh(self, channels: int) -> Past:
        """Return the initial state."""
        return np.full((self._rows - 1, channels), np.nan), np.full((self._means, channels), np.nan)

    def excess(
        self,
        readings: FloatArray,
        cleaned: FloatArray,
        mean: FloatArray,
        variance: FloatArray,
        spans: list[int],
        past: Past,
    ) -> tuple[NDArray[np.bool_], FloatArray, Past]:
        """Return which means carry an excess covariance, the excess of these [mm^2], and the next state.

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
        spans
            Number of readings in each mean.
        past
            The state.
        """
        rows, means = np.concatenate([past[0], cleaned]), np.concatenate([past[1], mean])
        deviations = windows(rows, self._rows) - mean[:, np.newaxis]
        deviations[:, -1] = readings - mean  # what replaced the newest reading may hide a touch
        working: NDArray[np.intp] | int = mean.shape[1]
        known: NDArray[np.bool_] = np.ones(deviations.shape[:2], dtype=np.bool_)
        if np.isnan(deviations.sum()):
            there = ~np.isnan(deviations)
            deviations[~there] = 0.0
            known[:] = there.any(axis=2)
            working = (~np.isnan(mean)).sum(axis=1)
        moves, squares = self._moves(deviations, working, spans)
        if cleaned is not readings:
            moves |= (np.abs(readings - cleaned) > 0).any(axis=1)  # False for NaN
        moving = np.flatnonzero(moves)
        excess = np.empty((len(moving), mean.shape[1], mean.shape[1]))
        if len(moving):
            before = windows(means[:-1], self._means)
            kinds = np.array(spans)[moving]
            for span in set(kinds.tolist()):
                at = moving[kinds == span]
                excess[kinds == span] = self._excess(
                    deviations[at], known[at], before[at] - mean[at, np.newaxis], variance[at], squares[at], span
                )
        return moves, excess, (rows[len(rows) - self._rows + 1 :], means[len(means) - self._means :])

    def _compared(self, span: int) -> int:
        """Return the number of readings that must agree to prove rest."""
        return max(span, self._still)

    def _moves(
        self, deviations: FloatArray, working: NDArray[np.intp] | int, spans: list[int]
    ) -> tuple[NDArray[np.bool_], FloatArray]:
        """Return which readings scatter, and their sums of squares in units of the noise, each of shape (readings,)."""
        units = deviations / self._unit_mm
        kinds = set(spans)
        if len(kinds) == 1:
            return self._look(spans[0]).scatter(units, working)
        moves, squares = np.empty(len(units), dtype=np.bool_), np.empty(len(units))
        for span in kinds:
            at = np.flatnonzero(np.array(spans) == span)
            moves[at], squares[at] = self._look(span).scatter(
                units[at], working if isinstance(working, int) else working[at]
            )
        return moves, squares

    def _look(self, span: int) -> Look:
        return look_at(self._compared(span), self._slope, self._rows, len(self._unit_mm))

    def _excess(
        self,
        deviations: FloatArray,
        known: NDArray[np.bool_],
        before: FloatArray,
        variance: FloatArray,
        squares: FloatArray,
        span: int,
    ) -> FloatArray:
        """Return the excess covariance of means that move, shape (means, channels, channels).

        Parameters
        ----------
        deviations
            Deviations of the readings from the mean [mm], shape (means, rows, channels); 0 if missing.
        known
            Which rows hold a reading of any channel, shape (means, rows).
        before
            Deviations of the earlier means from the mean [mm], shape (means, rows, channels); NaN if missing.
        variance
            Relative variance of the noise of the mean, shape (means, channels); NaN for a channel without a value.
        squares
            Sums of squares of the readings, in units of the noise, shape (means,).
        span
            Number of readings in each mean.
        """
        there = ~np.isnan(variance)
        own = np.where(there, variance, 0.0)
        number = max(span, self._half)
        excess = _positive_part(self._scatter_of_means(deviations, known, before[:, -number:], own, span))
        newest = deviations[:, -1]
        square = ((newest / self._unit_mm) ** 2).sum(axis=1)
        differs = square > self._look(span).newest_limit[there.sum(axis=1)]
        excess += self._change(np.where(differs[:, np.newaxis], newest, 0.0), deviations, span)
        # A direction that a single reading shows is as uncertain as that reading.
        single = square / np.maximum(squares, 1.0)
        isotropic = np.minimum(single, 1.0)[:, np.newaxis] * self._noise_mm**2
        isotropic = isotropic + UNSEEN**2 * np.trace(excess, axis1=1, axis2=2)[:, np.newaxis]
        excess += isotropic[:, :, np.newaxis] * self._identity
        return (excess + excess.transpose(0, 2, 1)) / 2 * (there[:, :, np.newaxis] & there[:, np.newaxis])

    def _scatter_of_means(
        self, deviations: FloatArray, known: NDArray[np.bool_], before: FloatArray, own: FloatArray, span: int
    ) -> FloatArray:
        """Return the mean product of the deviations of earlier means, without what noise explains.

        While there are too few earlier means, readings take their place.
        """
        number, compared = before.shape[1], self._compared(span)
        missing = np.isnan(before)
        before = np.where(missing, 0.0, before)
        count = (~missing).any(axis=2).sum(axis=1)
        part = count / number
        product = (before.transpose(0, 2, 1) @ before) * (part / np.maximum(count, 1))[:, np.newaxis, np.newaxis]
        if (count < number).any():
            readings = deviations[:, -compared:]
            taken = known[:, -compared:].sum(axis=1)
            share = (1 - part) / np.maximum(taken, 1)
            product += (readings.transpose(0, 2, 1) @ readings) * share[:, np.newaxis, np.newaxis]
        # A mean is as of the middle of its readings, so a steady motion has gone as far since as in as many readings.
        size = 1 / np.where(own > 0, own, 1.0).min(axis=1)
        half = np.clip(np.ceil((size - 1) / 2 - 1e-9), 0, number).astype(np.intp)
        lag = np.where((half > 0)[:, np.newaxis], before[np.arange(len(before)), number - half - (half == 0)], 0.0)
        product += lag[:, :, np.newaxis] * lag[:, np.newaxis]
        # Means that are j readings apart share n - j of their n readings.
        apart = np.minimum(np.arange(1, number + 1) * own[:, :, np.newaxis], 1.0).mean(axis=2)
        apart += np.minimum(half[:, np.newaxis] * own, 1.0)
        noise = 2 * own * apart * self._noise_mm**2
        scatter: FloatArray = product - noise[:, :, np.newaxis] * self._identity
        return (scatter + scatter.transpose(0, 2, 1)) / 2

    def _change(self, newest: FloatArray, deviations: FloatArray, span: int) -> FloatArray:
        """Return the product of the newest deviation, shape (means, channels), less what was usual before the mean.

        Before a touch nothing moved; while the beam rings, readings deviated as far before.
        """
        square = np.maximum((newest * newest).sum(axis=1), np.finfo(np.float64).tiny)
        direction = newest / np.sqrt(square)[:, np.newaxis]
        number = self._compared(span)
        rows = deviations[:, self._rows - span - number : self._rows - span]
        along = (rows @ direction[:, :, np.newaxis])[:, :, 0]
        scatter = ((along * along).sum(axis=1) - along.sum(axis=1) ** 2 / number) / max(number - 1, 1)
        noise = ((direction * self._noise_mm) ** 2).sum(axis=1)
        part = 1 - np.minimum(USUAL * np.maximum(scatter, noise) / square, 1.0)
        change: FloatArray = (newest * part[:, np.newaxis])[:, :, np.newaxis] * newest[:, np.newaxis]
        return change


def _positive_part(matrices: FloatArray) -> FloatArray:
    """Return the nearest positive semi-definite matrices of symmetric ones, shape (matrices, channels, channels)."""
    values, vectors = np.linalg.eigh(matrices)
    roots = vectors * np.sqrt(np.maximum(values, 0.0))[:, np.newaxis]
    positive: FloatArray = roots @ roots.transpose(0, 2, 1)
    return positive
