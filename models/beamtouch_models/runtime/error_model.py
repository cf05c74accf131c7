"""The error model of a sample: how far each channel may be off, for limits, placement, estimators and the service.

The variance of a channel that measures a deflection z under a force F is

    noise^2 + zero^2 + (gain z)^2 + (F dG)^2

with the noise of the sample, the error of the zero, the relative error of the gain, and the error dG of the influence
that the mounting of the sensors leaves; all are standard deviations. Only the noise averages away. What gains and zeros
add, which no sample can know, is the floor. `whitening` adds it to the covariance that a sample states of its mean: the
matrix that a model's graph takes. The last term depends on the force, so it is not in that matrix: `posterior` and the
graph add it at each place. Pure; float64.
"""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from beamtouch_common.digits import Rounded
from beamtouch_models.arrays import Bools, Floats, Indices

NORMAL_975 = 1.959964
"""97.5 % quantile; an interval of 95 % reaches this many standard deviations to either side."""


@dataclass(frozen=True, eq=False, repr=False)
class Errors(Rounded):
    """Errors of a sample, as standard deviations: a number for every channel, or (channels,) one for each.

    >>> Errors(0.003, gain=0.01, zero_mm=0.004).deviation_mm(np.array([[0.0, 1.2]]))
    array([[0.005, 0.013]])
    """

    noise_mm: float
    """Noise, which averages away."""
    gain: ArrayLike = 0.0
    """Relative error of the gain that is left after calibration."""
    zero_mm: ArrayLike = 0.0
    """Error of the zero."""
    mounting_mm: float = 0.0
    """Error of a sensor's place along each axis."""

    def variance_mm2(self, deflection_mm: Floats, moved_mm2: Floats | float = 0.0) -> Floats:
        """Return the variances of samples (..., channels) of deflections.

        `moved_mm2` (..., channels) is the variance of these deflections that the mounting of the sensors leaves.
        """
        floor = floor_mm2(deflection_mm, self.gain, self.zero_mm)
        variance: Floats = floor + np.square(self.noise_mm) + moved_mm2
        return variance

    def deviation_mm(self, deflection_mm: Floats, moved_mm2: Floats | float = 0.0) -> Floats:
        """Return the standard deviations; arguments as those of `variance_mm2`."""
        return np.sqrt(self.variance_mm2(deflection_mm, moved_mm2))

    def whitening(
        self, deflection_mm: Floats, covariance_mm2: Floats | None = None, valid: Bools | None = None
    ) -> Floats:
        """Return the whitening of samples, without what the mounting leaves, as the function of that name.

        `covariance_mm2` is that which each sample states; default: the noise, independent from channel to channel.
        """
        if covariance_mm2 is None:
            covariance_mm2 = np.eye(deflection_mm.shape[1]) * self.noise_mm**2
        return whitening(deflection_mm.astype(np.float64), covariance_mm2, self.gain, self.zero_mm, valid)

    def of_channels(self, channels: int) -> tuple[Floats, Floats]:
        """Return the errors of gain and zero of each channel, (channels,)."""
        return np.broadcast_to(self.gain, channels), np.broadcast_to(self.zero_mm, channels)

    def take(self, kept: Indices, channels: int) -> Self:
        """Return the errors of some of this number of channels."""
        gain, zero_mm = self.of_channels(channels)
        return replace(self, gain=gain[kept], zero_mm=zero_mm[kept])


def floor_mm2(deflection_mm: ArrayLike, gain: ArrayLike, zero_mm: ArrayLike) -> Floats:
    """Return what gains and zeros add to the variances of deflections (..., channels), in mm^2; arguments broadcast.

    `gain` and `zero_mm` are standard deviations, as those of `Errors`.
    """
    floor: Floats = np.square(np.asarray(gain) * deflection_mm) + np.square(zero_mm)
    return floor


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
    valid_pairs = valid[:, :, None] & valid[:, None, :]
    # A variance of 1 stands in for a missing channel; it is correlated with no other.
    missing = np.where(valid, 0.0, 1.0)
    total = np.where(valid_pairs, covariance_mm2, missing[:, :, None] * np.eye(valid.shape[1]))
    return np.where(valid_pairs, _of_all(total, np.where(valid, floor, 0.0)), 0.0)


def _of_all(covariance_mm2: Floats, floor_mm2: Floats) -> Floats:
    """Return the whitening where no channel is missing; `floor_mm2` (samples, channels) adds to the variances."""
    samples, channels = floor_mm2.shape
    variances, cells = slice(None, None, channels + 1), (-1, channels * channels)
    sample_variance_mm2 = covariance_mm2.reshape(cells)[:, variances]
    variance = sample_variance_mm2 + floor_mm2
    if not (variance.min(initial=np.inf) > 0 and variance.max(initial=0.0) < np.inf):  # False for NaN
        raise ValueError("covariance_mm2: every variance must be a positive finite number")
    deviation = np.sqrt(variance)
    if np.count_nonzero(covariance_mm2) == np.count_nonzero(sample_variance_mm2):
        diagonal = np.zeros((samples, channels * channels))
        diagonal[:, variances] = 1.0 / deviation
        return diagonal.reshape(samples, channels, channels)
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
        raise ValueError("covariance_mm2: it must be positive definite") from None
