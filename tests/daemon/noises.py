"""Recordings of a beam at rest with known noise."""

import math
from functools import cache

import numpy as np

from beamtouch_daemon.config.settings import Surface
from beamtouch_models.filters import FloatArray

from .surfaces import RATE_HZ, STEP_MM, mean_of, surface_of

NOISE_MM = 0.002
CHANNELS, MINUTE = 4, round(60 * RATE_HZ)


def four_channels(chosen: dict[str, object] | None = None, **changes: object) -> Surface:
    """Return a surface with a filter, by default a mean of 20 readings."""
    return surface_of(CHANNELS, filter=chosen or mean_of(20), **changes)


@cache
def autoregressive(alike: float, readings: int = MINUTE, seed: int = 3) -> FloatArray:
    """Noise of standard deviation 1 whose successive values have the correlation `alike`, (readings, channels)."""
    fresh = np.random.default_rng(seed).standard_normal((readings, CHANNELS))
    noise = fresh.copy()
    for index in range(1, readings if alike else 0):
        noise[index] = alike * noise[index - 1] + math.sqrt(1 - alike**2) * fresh[index]
    noise.setflags(write=False)
    return noise


def counts_of(deviation_mm: FloatArray) -> FloatArray:
    """Return the counts of deflections [mm]."""
    counts: FloatArray = np.rint((2.0 + deviation_mm) / STEP_MM)
    return counts
