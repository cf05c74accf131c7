"""Random zeros of whitened samples: uniform within twice their drift, and drawn where they matter.

Importance sampling tilts their density by exp(tilt . zero).
"""

import numpy as np

from beamtouch_models.arrays import Floats

DRIFTS = 2.0
"""Farthest a zero lies, in its drifts."""
MIN_EXPONENT = 1e-6
"""Smallest exponent; below it a tilt makes no difference."""


def reach_of(noise: Floats) -> Floats:
    """Return the farthest zeros (channels,) of whitened samples with noise of these deviations (channels,)."""
    reach: Floats = DRIFTS * np.sqrt(np.maximum(1 - noise**2, 0.0))
    return reach


def tilted(tilt: Floats, reach: Floats, rng: np.random.Generator) -> Floats:
    """Draw zeros (draws, channels) between -reach and reach with tilts (draws, channels)."""
    power = np.maximum(np.abs(tilt) * reach, MIN_EXPONENT)
    share = rng.random(tilt.shape)
    part = 1 + np.log(share + (1 - share) * np.exp(-2 * power)) / power
    zero: Floats = np.sign(tilt) * part * reach
    return zero


def log_tilt(zero: Floats, tilt: Floats, reach: Floats) -> Floats:
    """Return the log of the tilted over the even density, for zeros and tilts (..., channels)."""
    power = np.maximum(np.abs(tilt) * reach, MIN_EXPONENT)
    mean = power + np.log(-np.expm1(-2 * power)) - np.log(2 * power)
    log: Floats = (zero * tilt).sum(axis=-1) - mean.sum(axis=-1)
    return log
