"""The covariance of means that move, beyond that of white noise: how far they may be off, and in which pattern."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beamtouch_models.filters.means import FloatArray

USUAL = 1.5
"""The newest reading deviates from the mean as usual if its square is within this many times the scatter before the
mean; that of a vibration is on average once and at most twice it."""
UNSEEN = 0.03
"""Motion that the scatter does not show, relative to that which it shows. Modes that swing as fast as the readings come
seem to stand still; and the mean deflection over a long way is that of no single contact."""


@dataclass(frozen=True)
class Evidence:
    """What is known of some means that move."""

    deviations: FloatArray
    """Deviations of the readings from the mean [mm], shape (means, rows, channels); 0 if missing."""
    known: NDArray[np.bool_] | None
    """Which readings there are, of the same shape; None: all."""
    missing: FloatArray | None
    """Part of the last readings that each channel lacks, shape (means, channels); None: nothing."""
    before: FloatArray
    """Deviations of the earlier means from the mean [mm], shape (means, rows, channels); NaN if missing."""
    variance: FloatArray
    """Relative variance of the noise of the mean, shape (means, channels); NaN for a channel without a value."""
    squares: FloatArray
    """Sums of squares of the readings, in units of the noise, shape (means,)."""
    slopes: FloatArray
    """Slope per reading, in units of the noise, shape (means, channels); 0 if there is none."""
    unfair: NDArray[np.bool_]
    """Whether the mean is not that of the readings in its window, shape (means,)."""


class Excess:
    """Computes the excess covariance.

    Parameters
    ----------
    noise_mm, unit_mm
        Standard deviation of a reading, shape (channels,), and what deviations are compared with.
    half
        Number of earlier means that scatter by the amplitude of the slowest motion.
    """

    def __init__(self, noise_mm: FloatArray, unit_mm: FloatArray, half: int) -> None:
        self._noise_mm, self._unit_mm, self._half = noise_mm, unit_mm, half
        self._identity = np.eye(len(noise_mm))

    def of(self, evidence: Evidence, span: int, compared: int, newest_limit: FloatArray) -> FloatArray:
        """Return the excess covariance [mm^2], shape (means, channels, channels).

        Parameters
        ----------
        evidence
            What is known of the means.
        span, compared
            Number of readings in each mean, and of those that prove rest.
        newest_limit
            Limit of the square of the newest deviation, by the number of working channels.
        """
        there = ~np.isnan(evidence.variance)
        own = np.where(there, evidence.variance, 0.0)
        size = 1 / np.where(own > 0, own, 1.0).min(axis=1)
        excess = _positive_part(self._scatter_of_means(evidence, own, size, span, compared))
        newest = evidence.deviations[:, -1]
        square = ((newest / self._unit_mm) ** 2).sum(axis=1)
        differs = square > newest_limit[there.sum(axis=1)]
        excess += self._change(np.where(differs[:, np.newaxis], newest, 0.0), evidence.deviations, span, compared)
        # A mean is as of the middle of its readings.
        excess += _products(evidence.slopes * self._unit_mm * (size[:, np.newaxis] - 1) / 2)
        if evidence.unfair.any():
            excess += _products(self._replaced(evidence, span))
        # A direction that a single reading shows is as uncertain as that reading.
        single = square / np.maximum(evidence.squares, 1.0)
        each = np.minimum(single, 1.0)[:, np.newaxis] * self._noise_mm**2
        each = each + UNSEEN**2 * np.trace(excess, axis1=1, axis2=2)[:, np.newaxis]
        if evidence.missing is not None and evidence.missing.any():
            each = each + self._left_out(evidence) ** 2
        excess += each[:, :, np.newaxis] * self._identity
        return (excess + excess.transpose(0, 2, 1)) / 2 * (there[:, :, np.newaxis] & there[:, np.newaxis])

    def _scatter_of_means(
        self, evidence: Evidence, own: FloatArray, size: FloatArray, span: int, compared: int
    ) -> FloatArray:
        """Return the mean product of the deviations of earlier means, without what noise explains.

        While there are too few earlier means, readings take their place.
        """
        before = evidence.before[:, -max(span, self._half) :]
        number = before.shape[1]
        missing = np.isnan(before)
        before = np.where(missing, 0.0, before)
        count = (~missing).any(axis=2).sum(axis=1)
        part = count / number
        product = (before.transpose(0, 2, 1) @ before) * (part / np.maximum(count, 1))[:, np.newaxis, np.newaxis]
        if (count < number).any():
            readings = evidence.deviations[:, -compared:]
            taken = compared if evidence.known is None else evidence.known[:, -compared:].any(axis=2).sum(axis=1)
            share = (1 - part) / np.maximum(taken, 1)
            product += (readings.transpose(0, 2, 1) @ readings) * share[:, np.newaxis, np.newaxis]
        # A mean is as of the middle of its readings, so a steady motion has gone as far since as in as many readings.
        half = np.clip(np.ceil((size - 1) / 2 - 1e-9), 0, number).astype(np.intp)
        lag = np.where((half > 0)[:, np.newaxis], before[np.arange(len(before)), number - half - (half == 0)], 0.0)
        product += _products(lag)
        # Means that are j readings apart share n - j of their n readings.
        apart = np.minimum(np.arange(1, number + 1) * own[:, :, np.newaxis], 1.0).mean(axis=2)
        apart += np.minimum(half[:, np.newaxis] * own, 1.0)
        noise = 2 * own * apart * self._noise_mm**2
        scatter: FloatArray = product - noise[:, :, np.newaxis] * self._identity
        return (scatter + scatter.transpose(0, 2, 1)) / 2

    def _change(self, newest: FloatArray, deviations: FloatArray, span: int, compared: int) -> FloatArray:
        """Return the product of the newest deviation, shape (means, channels), less what was usual before the mean.

        Before a touch nothing moved; while the beam rings, readings deviated as far before.
        """
        square = np.maximum((newest * newest).sum(axis=1), np.finfo(np.float64).tiny)
        direction = newest / np.sqrt(square)[:, np.newaxis]
        end = deviations.shape[1] - span
        along = (deviations[:, end - compared : end] @ direction[:, :, np.newaxis])[:, :, 0]
        scatter = ((along * along).sum(axis=1) - along.sum(axis=1) ** 2 / compared) / max(compared - 1, 1)
        noise = ((direction * self._noise_mm) ** 2).sum(axis=1)
        part = 1 - np.minimum(USUAL * np.maximum(scatter, noise) / square, 1.0)
        change: FloatArray = (newest * part[:, np.newaxis])[:, :, np.newaxis] * newest[:, np.newaxis]
        return change

    def _replaced(self, evidence: Evidence, span: int) -> FloatArray:
        """Return how far the mean of all readings in the window is from the stated mean [mm], (means, channels)."""
        deviations = evidence.deviations[:, -span:]
        number = span if evidence.known is None else np.maximum(evidence.known[:, -span:].sum(axis=1), 1)
        apart: FloatArray = deviations.sum(axis=1) / number * evidence.unfair[:, np.newaxis]
        return apart

    def _left_out(self, evidence: Evidence) -> FloatArray:
        """Return how far missing readings may move the mean [mm], shape (means, channels).

        Where a beam moves, readings are missing because they are beyond the range of the sensor. They are about as far
        from the others as these are apart.
        """
        if evidence.known is None or evidence.missing is None:
            return np.zeros_like(evidence.slopes)
        highest = np.where(evidence.known, evidence.deviations, -np.inf).max(axis=1)
        lowest = np.where(evidence.known, evidence.deviations, np.inf).min(axis=1)
        away: FloatArray = evidence.missing * np.maximum(highest - lowest, 0.0)
        return np.where(np.isfinite(away), away, 0.0)


def _products(vectors: FloatArray) -> FloatArray:
    """Return the product of each vector (means, channels) with itself, shape (means, channels, channels)."""
    return vectors[:, :, np.newaxis] * vectors[:, np.newaxis]


def _positive_part(matrices: FloatArray) -> FloatArray:
    """Return the nearest positive semi-definite matrices of symmetric ones, shape (matrices, channels, channels)."""
    values, vectors = np.linalg.eigh(matrices)
    roots = vectors * np.sqrt(np.maximum(values, 0.0))[:, np.newaxis]
    positive: FloatArray = roots @ roots.transpose(0, 2, 1)
    return positive
