"""Correlation in time of readings at rest: their trend and their autocovariances."""

import numpy as np

from beamtouch_models.filters import FloatArray

WINDOW = 5.0
"""Length of the sum of correlations, in correlation times (Sokal, Monte Carlo methods, 1997, sec. 3)."""


def without_line(values: FloatArray) -> FloatArray:
    """Return values, shape (readings, channels), without their mean and their straight trend."""
    time = np.arange(len(values)) - (len(values) - 1) / 2
    centred = values - values.mean(axis=0)
    residual: FloatArray = centred - time[:, np.newaxis] * (time @ centred / (time @ time))
    return residual


def summed_correlations(blocks: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the sum of the autocovariances over all lags, and the variance within blocks, each of shape (channels,).

    `blocks` has shape (blocks, readings, channels).
    """
    length = blocks.shape[1]
    centred = blocks - blocks.mean(axis=1, keepdims=True)
    size = 1 << (2 * length - 1).bit_length()
    power = np.abs(np.fft.rfft(centred, size, axis=1)) ** 2
    lags = np.fft.irfft(power.mean(axis=0), size, axis=0)[:length]
    lags /= np.arange(length, 0, -1)[:, np.newaxis]
    last = np.arange(length // 5)
    totals = 2 * np.cumsum(lags[: length // 5], axis=0) - lags[0]
    totals /= (1 - (2 * last + 1) / length)[:, np.newaxis]  # the part that the means of the blocks removed
    summed = np.empty(blocks.shape[2])
    for channel, total in enumerate(totals.T):
        enough = last * lags[0, channel] >= WINDOW * total
        summed[channel] = max(total[int(np.argmax(enough)) if enough.any() else -1], 0.0)
    return summed, lags[0]
