"""Surfaces as the configuration states them, with a line for a characteristic, and recordings of beams with noise."""

import math
from collections.abc import Mapping
from functools import cache

import numpy as np

from beamtouch_daemon.config.settings import Surface
from beamtouch_models.filters import FloatArray

STEP_MM = 0.0001
"""Of a count."""
RATE_HZ = 200.0
NOISE_MM = 0.002
CHANNELS, MINUTE = 4, round(60 * RATE_HZ)
WORDS = 4
"""Registers from one channel to the next: those of the longest type."""
CHANNEL = {"gain_mm_per_count": -STEP_MM, "offset_mm": 4.5, "rest_gap_mm": 2.5, "range_mm": [1.0, 4.0]}
"""A count of 20000 is the gap at rest."""


def surface_of(channels: int = 2, channel: Mapping[str, object] | None = None, /, **changes: object) -> Surface:
    """Return a surface; `changes` are further keys of it, and `channel` has those of each channel."""
    numbered = [
        {"name": f"s{index + 1}", "register": WORDS * index} | CHANNEL | dict(channel or {})
        for index in range(channels)
    ]
    source = {"kind": "modbus-tcp", "host": "127.0.0.1"}
    return Surface.model_validate({"rate_hz": RATE_HZ, "source": source, "channels": numbered} | changes)


def mean_of(window: int) -> dict[str, object]:
    """Return the settings of a mean of so many readings."""
    return {"kind": "moving-average", "window": window}


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


def of_white(window: int, alike: float) -> float:
    """Standard deviation of a mean of autoregressive noise over that of white noise: the sum of all covariances."""
    lags = np.arange(1, window)
    return math.sqrt(1 + 2 * float(np.sum((1 - lags / window) * alike**lags)))
