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
        How many newest readings they are, shape (means, numbers), or (1, numbers) if that is the same for all.
    limits
        Squares that noise explains, shape (means,), or the same for all.
    variance
        Relative variance of the noise of each mean, shape (means,).
    """
    lags = np.zeros((len(projected), projected.shape[2]))
    if not numbers.shape[1]:
        return lags
    # A mean shares its newest readings with those that it is compared with.
    own = np.maximum(1 - numbers * variance[:, np.newaxis], np.finfo(np.float64).tiny)
    explained = np.reshape(limits, (-1, 1)) * own
    above = squares > explained
    if above.any():
        above &= own > 1 - SHARED
        ratio = np.where(above, squares / np.where(above, explained, 1.0), 1.0)
        best, at = ratio.argmax(axis=1), np.arange(len(ratio))
        part = np.sqrt((1 - 1 / ratio[at, best]) / np.broadcast_to(numbers, ratio.shape)[at, best])
        lags[:] = projected[at, best] * part[:, np.newaxis]
    return lags


def drift_lags(units: FloatArray, variance: FloatArray, limit: float) -> FloatArray:
    """Return the lags of means of readings that drift, in units of the noise, shape (means, channels).

    They are 0 where noise explains the drift.

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
    known = ~np.isnan(units)
    units, seen = np.where(known, units, 0.0), np.any(known, axis=2)
    for number in set(compared.tolist()):
        at = compared == number
        new, old = (slice(-number, None), slice(-2 * number, -number))
        few, many = known[at, new].sum(axis=1), known[at, old].sum(axis=1)
        drift = units[at, new].sum(axis=1) / np.maximum(few, 1) - units[at, old].sum(axis=1) / np.maximum(many, 1)
        weight = few * many / np.maximum(few + many, 1)
        drift = np.where(weight > 0, drift, 0.0)
        square = np.maximum((drift * drift * weight).sum(axis=1), np.maximum(limit, np.finfo(np.float64).tiny))
        # A steady drift moves by `drift` in `number` rows. The middle of the mean is (size - 1) / 2 rows old, or older
        # if some of them are lost.
        rows = sizes[at] * 2 * number / np.maximum(seen[at, -2 * number :].sum(axis=1), 1)
        part = np.sqrt(1 - limit / square) * (rows - 1) / (2 * number)
        lags[at] = drift * part[:, np.newaxis]
    return lags
