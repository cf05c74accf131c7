"""Filters as stages of a chain, with their parameters; and the stages of a filter that a model chooses."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Literal

import numpy as np

from beamtouch_models.filters import means
from beamtouch_models.filters.look import Look
from beamtouch_models.filters.means import FloatArray, Stepped

ROUNDING = 1e-6
"""Part of a reading by which a time may fall short of a whole number of readings, as it was rounded."""
MIN_FILL = 0.5
"""Part of the averaging window that good readings must fill before a channel has a value.

The noise of that first value is at most 1.4 times that of a full window. A single reading would be noisier still, and
could make a beam at rest look touched; a larger part would leave no value where a third of the readings is lost.
"""
MAX_COMPARED = 8
"""Newest readings of a growing mean whose scatter is tested. The mean itself shows slower motion."""


@dataclass(frozen=True)
class Stage:
    """One filter with its parameters."""

    memory: int
    """Number of rows of its state."""
    step: Callable[[FloatArray, FloatArray], Stepped] | None = None
    """Takes a signal and a state; None: the mean is of the readings that agree, as `look` sees it."""
    span: int = 1
    """Number of readings in the mean whose scatter is tested; 1 if the filter averages nothing."""
    spike_mm: float = math.inf
    """Distance of a spike from the median; inf if the filter leaves no spikes out."""
    look: Look | None = None
    """What a growing mean looks with."""


def spike_stage(limit_mm: float) -> Stage:
    """Return `spike` as a stage."""
    return Stage(means.SPIKE_MEMORY, partial(means.spike, limit_mm=limit_mm), spike_mm=limit_mm)


def moving_average_stage(window: int, needed: int = 1) -> Stage:
    """Return `moving_average` as a stage."""
    return Stage(window - 1, partial(means.moving_average, window=window, needed=needed), window)


def filled(window: int) -> int:
    """Return how many good readings a window needs for a value."""
    return math.ceil(MIN_FILL * window)


def growing_mean_stage(
    longest: int, unit_mm: FloatArray, spike_mm: float | None = None, fewest: int = 1, slowest_period: float = 0.0
) -> Stage:
    """Return a growing mean as a stage; it leaves out spikes itself. The parameters are those of `Look`."""
    spike = math.inf if spike_mm is None else spike_mm
    look = Look(longest, unit_mm, spike, fewest, slowest_period)
    return Stage(longest, span=min(longest, MAX_COMPARED), spike_mm=spike, look=look)


def unit_of(noise_mm: float | FloatArray, step_mm: float | FloatArray, channels: int) -> FloatArray:
    """Return the deviation (channels,) that readings at rest reach: their noise, or half a step of the ADC."""
    unit: FloatArray = np.broadcast_to(np.maximum(noise_mm, np.abs(step_mm) / 2), (channels,))
    return unit


def readings_within(time_ms: float, rate_hz: float) -> int:
    """Return how many readings fit in a time."""
    return math.floor(time_ms * rate_hz / 1e3 + ROUNDING)


def chosen_stages(
    kind: Literal["none", "moving-average", "growing-mean"],
    *,
    window: int,
    longest: int,
    spike_mm: float | None,
    unit_mm: FloatArray,
    slowest_period: float,
) -> tuple[Stage, ...]:
    """Return the stages of a filter that a model may choose, in the order in which they apply.

    Parameters
    ----------
    kind
        Which mean is taken.
    window
        Number of readings in a moving average, or the fewest in a growing mean.
    longest
        Largest number of readings in a growing mean.
    spike_mm
        Distance of a spike from the median of three readings; None: all readings count.
    unit_mm
        Deviation that readings at rest reach, shape (channels,).
    slowest_period
        Period of the slowest motion, in readings; 0 if it is not known.
    """
    if kind == "growing-mean":
        return (growing_mean_stage(longest, unit_mm, spike_mm, window, slowest_period),)
    spike = () if spike_mm is None else (spike_stage(spike_mm),)
    if kind == "none":
        return spike
    return (*spike, moving_average_stage(window, filled(window)))
