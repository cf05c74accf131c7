"""The total covariance of a sample, as the whitening matrix that a model's graph takes. Pure; float64.

The sample states the covariance C of its mean. The floor adds what no sample can know: the errors of gain and zero that
are left after calibration, diag((g z)^2 + d^2). It never averages away.
"""

import numpy as np
from numpy.typing import ArrayLike

from beamtouch_models.arrays import Bools, Floats


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
    present = np.ones(deflection_mm.shape, np.bool_) if valid is None else valid
    floor = (np.asarray(gain) * np.where(present, deflection_mm, 0.0)) ** 2 + np.square(zero_mm)
    channels = np.arange(deflection_mm.shape[1])
    both = present[:, :, None] & present[:, None, :]
    total = np.where(both, covariance_mm2, 0.0)
    variance = np.where(present, total[:, channels, channels] + floor, 1.0)
    if not ((variance > 0) & (variance < np.inf)).all():
        message = "covariance_mm2: every variance must be a positive finite number"
        raise ValueError(message)
    # The factor of the correlations is exact where channels differ in scale; a diagonal covariance needs no factor.
    deviation = np.sqrt(variance)
    total /= deviation[:, :, None]
    total /= deviation[:, None, :]
    total[:, channels, channels] = 1.0
    diagonal = np.count_nonzero(total) == deflection_mm.size
    inverse = total if diagonal else np.tril(np.linalg.inv(_factor(total)))
    whole: Floats = np.where(both, inverse / deviation[:, None, :], 0.0)
    return whole


def _factor(correlation: Floats) -> Floats:
    """Return the lower Cholesky factors; raises ValueError if one does not exist."""
    try:
        return np.linalg.cholesky(correlation).astype(np.float64, copy=False)
    except np.linalg.LinAlgError:
        message = "covariance_mm2: it must be positive definite"
        raise ValueError(message) from None
