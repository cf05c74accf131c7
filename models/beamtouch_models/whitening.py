"""The total covariance of a sample, as the whitening matrix that a model's graph takes. Pure; float64.

The sample states the covariance C of its mean. The floor adds what no sample can know: the errors of gain and zero that
are left after calibration, diag((g z)^2 + d^2). It never averages away.
"""

import numpy as np
from numpy.typing import ArrayLike

from beamtouch_models.arrays import Bools, Floats
from beamtouch_models.error_model import floor_mm2


def whitening(
    deflection_mm: Floats, covariance_mm2: Floats, gain: ArrayLike, zero_mm: ArrayLike, valid: Bools | None = None
) -> Floats:
    """Return W with W'W the inverse of the total covariance, in 1/mm, lower triangular; (samples, channels, channels).

    Parameters
    ----------
    deflection_mm : (samples, channels), the measured mean of each sample; a missing channel is ignored
    covariance_mm2 : (samples, channels, channels) or (channels, channels), covariance of that mean
    gain : (channels,) or one number, standard deviation of the relative gain error
    zero_mm : (channels,) or one number, standard deviation of the zero
    valid : (samples, channels), False for a channel that is missing: its row and column of W are zero

    Raises
    ------
    ValueError
        A total covariance is not finite or not positive definite.
    """
    if valid is None or valid.all():
        return _of_all(covariance_mm2, floor_mm2(deflection_mm, gain, zero_mm))
    floor = floor_mm2(np.where(valid, deflection_mm, 0.0), gain, zero_mm)
    both = valid[:, :, None] & valid[:, None, :]
    # A variance of 1 stands in for a missing channel; it is correlated with no other.
    missing = np.where(valid, 0.0, 1.0)
    total = np.where(both, covariance_mm2, missing[:, :, None] * np.eye(valid.shape[1]))
    return np.where(both, _of_all(total, np.where(valid, floor, 0.0)), 0.0)


def _of_all(covariance_mm2: Floats, floor_mm2: Floats) -> Floats:
    """Return the whitening where no channel is missing; `floor_mm2` (samples, channels) adds to the variances."""
    samples, channels = floor_mm2.shape
    variances, cells = slice(None, None, channels + 1), (-1, channels * channels)
    stated = covariance_mm2.reshape(cells)[:, variances]
    variance = stated + floor_mm2
    if not (variance.min(initial=np.inf) > 0 and variance.max(initial=0.0) < np.inf):  # False for NaN
        message = "covariance_mm2: every variance must be a positive finite number"
        raise ValueError(message)
    deviation = np.sqrt(variance)
    if np.count_nonzero(covariance_mm2) == np.count_nonzero(stated):
        whole = np.zeros((samples, channels * channels))
        whole[:, variances] = 1.0 / deviation
        return whole.reshape(samples, channels, channels)
    # The factor of the correlations is exact where channels differ in scale.
    total = np.empty((samples, channels, channels))
    np.divide(covariance_mm2, deviation[:, :, None], out=total)
    total /= deviation[:, None, :]
    total.reshape(cells)[:, variances] = 1.0
    inverse: Floats = np.tril(np.linalg.inv(_factor(total))) / deviation[:, None, :]
    return inverse


def _factor(correlation: Floats) -> Floats:
    """Return the lower Cholesky factors; raises ValueError if one does not exist."""
    try:
        return np.linalg.cholesky(correlation).astype(np.float64, copy=False)
    except np.linalg.LinAlgError:
        message = "covariance_mm2: it must be positive definite"
        raise ValueError(message) from None
