"""The error model of a sample: how far each channel may be off, for limits, placement, estimators and the service.

The variance of a channel that measures a deflection z under a force F is

    noise^2 + zero^2 + (gain z)^2 + (F dG)^2

with the noise of the sample, the error of the zero, the relative error of the gain, and the error dG of the influence
that the mounting of the sensors leaves; all are standard deviations. Only the noise averages away. Pure; float64.
"""

import numpy as np
from numpy.typing import ArrayLike

from beamtouch_models.arrays import Floats


def floor_mm2(deflection_mm: ArrayLike, gain: ArrayLike, zero_mm: ArrayLike) -> Floats:
    """Return what gains and zeros add to the variances; arguments as those of `variance_mm2`."""
    floor: Floats = np.square(np.asarray(gain) * deflection_mm) + np.square(zero_mm)
    return floor


def variance_mm2(
    deflection_mm: ArrayLike,
    noise_mm: ArrayLike = 0.0,
    gain: ArrayLike = 0.0,
    zero_mm: ArrayLike = 0.0,
    moved_mm: ArrayLike = 0.0,
) -> Floats:
    """Return the variances of samples (..., channels) in mm^2; the arguments broadcast to that shape.

    Parameters
    ----------
    deflection_mm : (..., channels) in mm
    noise_mm : standard deviation of the noise
    gain : standard deviation of the relative error of the gain
    zero_mm : standard deviation of the zero
    moved_mm : standard deviation of the deflection that the mounting of the sensors leaves, F dG
    """
    variance: Floats = floor_mm2(deflection_mm, gain, zero_mm) + np.square(noise_mm) + np.square(moved_mm)
    return variance
