"""The error that rounding to counts leaves in the mean of many readings."""

import math

import numpy as np

HARMONICS = 1000
"""Harmonics of the rounding error; those beyond it hold 0.03 % of its standard deviation."""
MAX_EXPONENT = 700.0
"""exp(-700) is still a float64."""


def rounding_of(noise_mm: float, step_mm: float) -> float:
    """Return the standard deviation in mm of that error, for noise before rounding and a step of the ADC, both in mm.

    The mean of rounded readings deviates from the gap by a periodic function of it, with the harmonics
    q / (pi k) exp(-2 (pi k s / q)^2) for a step of q and noise of s (Widrow & Kollar, 2008, ch. 4). Without noise it is
    q / sqrt(12); at s = q / 2 it is gone. It counts twice, as the rest gap, which `tare` measures, is rounded too.
    """
    if step_mm == 0:
        return 0.0
    order = np.arange(1, HARMONICS + 1)
    decay = np.exp(-np.minimum(2 * (np.pi * order * noise_mm / step_mm) ** 2, MAX_EXPONENT))
    single = step_mm * math.sqrt(float(np.sum((decay / (np.pi * order)) ** 2)) / 2)
    return math.sqrt(2) * single
