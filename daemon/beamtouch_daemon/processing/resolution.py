"""The resolution of the channels: the smallest changes that their counts show. Pure.

A whole number shows a change of 1. The type of a fractional number does not say its step: it is not finer than the last
digit, but the ADC or the sensor behind it may be much coarser. A recording says more.
"""

import numpy as np

from beamtouch_daemon.config.settings import Surface
from beamtouch_daemon.config.value_types import spacing_of
from beamtouch_models.filters import FloatArray

JITTER = 2.0
"""A fractional number that changes by no more than this many of its smallest changes has not changed: the arithmetic of
a device does as much."""


def finest(surface: Surface) -> FloatArray:
    """Return the smallest change that the type of each channel's counts can show [counts], shape (channels,)."""
    pairs = zip(surface.value_types, surface.channels, strict=True)
    return np.array([spacing_of(value_type, max(map(abs, channel.linear_counts))) for value_type, channel in pairs])


def tolerance(surface: Surface) -> FloatArray:
    """Return up to which change counts are equal [counts], shape (channels,); 0 for whole numbers."""
    return np.where(surface.has_fractions, JITTER * finest(surface), 0.0)


def steps_shown(counts: FloatArray, surface: Surface) -> FloatArray:
    """Return the smallest change between the counts of each channel, shape (channels,); inf if it has none.

    Arguments as of `changes_shown`.
    """
    return np.array([changes.min(initial=np.inf) for changes in changes_shown(counts, surface)])


def changes_shown(counts: FloatArray, surface: Surface) -> list[FloatArray]:
    """Return the changes from each value of a channel to the next larger one, for each channel.

    `counts` has the shape (readings, channels); missing ones (NaN) are left out. The changes are in counts.
    """
    steps = [np.diff(np.unique(column[~np.isnan(column)])) for column in counts.T]
    return [changes[changes > equal] for changes, equal in zip(steps, tolerance(surface).tolist(), strict=True)]
