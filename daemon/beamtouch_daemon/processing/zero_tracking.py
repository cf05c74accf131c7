"""Zero tracking: removes a slow drift of the rest gaps from the deflections while nothing touches the beam.

It follows the rule of weighing instruments (OIML R 76-1): near zero, when stable, slowly, within a limit. When
all channels have been good and within a band for a second, the zero of each channel moves towards its deflection, at a
limited rate and up to a limited total. Anything else stops all zeros until a second after it. Lost readings are no
disturbance, and prove no calm; only a gap of a second is like one. So a sudden contact that
deflects any channel by more than the band never counts as drift, however long it lasts. A contact that stays within the
band in all channels does, and so does one that grows as slowly as the rate, until the total is reached.

The band applies to single readings. It must be a few standard deviations wide, or noise alone stops the zeros: Gaussian
noise exceeds 4.5 standard deviations once in 150 000 readings. A wider band misses light contacts.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from beamtouch_daemon.config.signal import ZeroTracking
from beamtouch_models.filters import FloatArray

CALM_S = 1.0
CALM_READINGS = 10
"""Zeros move after the longer of this time and this number of readings within the band."""


@dataclass(frozen=True)
class Rules:
    """The configuration, converted to steps per reading."""

    band_mm: float
    step_mm: float
    """Largest step of a zero with one reading."""
    max_mm: float
    calm: int
    """Readings in a row within the band, including the newest, before zeros move."""

    @classmethod
    def of(cls, settings: ZeroTracking, rate_hz: float) -> "Rules":
        """Return the rules of a configuration at a rate of readings."""
        calm = max(CALM_READINGS, math.ceil(CALM_S * rate_hz))
        return cls(settings.band_mm, settings.rate_mm_per_min / 60 / rate_hz, settings.max_mm, calm)


@dataclass(frozen=True)
class State:
    """State after a reading."""

    zero_mm: FloatArray
    """Zero of each channel, to be subtracted, shape (channels,)."""
    calm: int = 0
    """Readings within the band since the last disturbance."""


def fresh(channels: int) -> State:
    """Return the initial state."""
    return State(np.zeros(channels))


def track(
    deflection: FloatArray, state: State, rules: Rules, lost: Sequence[int] | None = None
) -> tuple[FloatArray, State]:
    """Return the zero to subtract from each deflection [mm], and the state after them.

    A zero depends only on earlier readings, and any split of the stream gives the same zeros. Steps of a limited size
    make it follow the median, which a few odd readings do not move.

    Parameters
    ----------
    deflection
        Deflections [mm], shape (readings, channels), oldest first; NaN where a channel is not good.
    state
        State after the previous readings.
    rules
        Rules for the zeros.
    lost
        Number of readings lost before each, shape (readings,); None: none.
    """
    zeros = np.empty_like(deflection)
    zero, calm = state.zero_mm, state.calm
    for row, (value, gap) in enumerate(zip(deflection, lost or [0] * len(deflection), strict=True)):
        zeros[row] = zero
        if gap >= rules.calm:
            calm = 0
        left = value - zero
        if not np.all(np.abs(left) <= rules.band_mm):  # NaN, a channel that is not good, is outside the band too
            calm = 0
            continue
        calm += 1
        if calm >= rules.calm:
            moved = zero + np.clip(left, -rules.step_mm, rules.step_mm)
            zero = np.clip(moved, -rules.max_mm, rules.max_mm)
    return zeros, State(zero, calm)
