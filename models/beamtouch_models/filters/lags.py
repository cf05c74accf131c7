"""The lag of a mean of many readings behind the newest ones.

Such a mean is so precise that a load which begins to move leaves its interval before any test can know. So numbers of
newest readings, each twice the one before, are compared with the mean. The part of their distance that noise does not
explain counts as its uncertainty. At rest that is little, and rare.

If the readings drift, their mean lags by half of its distance to the mean of as many readings before it.
"""

import numpy as np

from beamtouch_models.filters.means import FloatArray

LAGS = 0.1
"""Probability at rest that a number of newest readings seem to be apart from the mean."""
SHARED = 0.99
"""Largest part of a mean that may be the newest readings that it is compared with."""


def lags_of(
    projected: FloatArray, squares: FloatArray, numbers: FloatArray, limits: FloatArray, variance: FloatArray
) -> FloatArray:
    """Return the lags of means, in units of the noise, shape (means, channels); 0 where noise explains the distance.

    Parameters
    ----------
    projected
        Sums of the newest deviations over the root of their number, in units of the noise, shape (means, numbers,
        channels).
    squares
        Their squares, summed over the channels, shape (means, numbers).
    numbers
        How many newest readings they are, shape (numbers,).
    limits
        Squares that noise explains, shape (means,), or the same for all.
    variance
        Relative variance of the noise of each mean, shape (means,).
    """
    lags = np.zeros((len(projected), projected.shape[2]))
    if not len(numbers):
        return lags
    # A mean shares its newest readings with those that it is compared with.
    own = 1 - numbers * variance[:, np.newaxis]
    explained = np.reshape(limits, (-1, 1)) * own
    above = squares > explained
    if above.any():
        above &= own > 1 - SHARED
        ratio = np.where(above, squares / np.where(above, explained, 1.0), 1.0)
        best, at = ratio.argmax(axis=1), np.arange(len(ratio))
        part = np.sqrt((1 - 1 / ratio[at, best]) / numbers[best])
        lags[:] = projected[at, best] * part[:, np.newaxis]
    return lags


def drift_lags(units: FloatArray, variance: FloatArray, limit: float) -> FloatArray:
    """Return the lags of means of readings that drift, in units of the noise, shape (means, channels).

    They are 0 where noise explains the drift, and for a channel that lacks readings.

    Parameters
    ----------
    units
        Readings up to the newest one in each mean, in units of the noise, shape (means, rows, channels).
    variance
        Relative variance of the noise of each mean, shape (means,).
    limit
        Square that noise explains.
    """
    lags, sizes = np.zeros((len(units), units.shape[2])), np.rint(1 / variance).astype(np.intp)
    compared = np.minimum(sizes, units.shape[1] // 2)
    for number in set(compared.tolist()):
        at = compared == number
        drift = np.nan_to_num(units[at, -number:].mean(axis=1) - units[at, -2 * number : -number].mean(axis=1))
        square = np.maximum((drift * drift).sum(axis=1) * number / 2, limit)
        # A steady drift moves by `drift` in `number` readings; the middle of the mean is (size - 1) / 2 readings old.
        part = np.sqrt(1 - limit / square) * (sizes[at] - 1) / (2 * number)
        lags[at] = drift * part[:, np.newaxis]
    return lags
