"""Zero tracking: takes a slow drift of the rest gaps off the deflection while nothing happens.

As a weighing instrument does it (OIML R 76-1: near zero only, when stable only, slowly, not too far): while all
channels are good and none has deflected by more than a band for a second, the zero of each channel moves towards what
it measures, at a limited rate and to a limited total. As soon as anything happens, and for the second after it, all
zeros stand still. So a contact that comes at once is never taken for drift, however long it rests, if it deflects any
channel by more than the band. One that stays within the band in all channels is, and so is one that comes as slowly as
the rate, until the total is reached.

The band is compared with single readings. It has to be a few standard deviations of a reading, or noise alone keeps
the zeros from moving: of Gaussian noise 4.5 standard deviations are passed once in 150 000 readings. More than that
makes it blind to light contacts.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beamtouch_daemon.config.signal import ZeroTracking

FloatArray = NDArray[np.float64]

CALM_S = 1.0
CALM_READINGS = 10
"""How long nothing may have happened: the longer of a time and a number of readings."""


@dataclass(frozen=True)
class Rules:
    """The configuration, by reading."""

    band_mm: float
    step_mm: float
    """The most that a zero moves with one reading."""
    most_mm: float
    calm: int
    """Readings in a row in which nothing may have happened, the newest included."""

    @classmethod
    def of(cls, settings: ZeroTracking, rate_hz: float) -> "Rules":
        """Take the rules from the configuration of a surface with so many readings per second."""
        calm = max(CALM_READINGS, math.ceil(CALM_S * rate_hz))
        return cls(settings.band_mm, settings.rate_mm_per_min / 60 / rate_hz, settings.most_mm, calm)


@dataclass(frozen=True)
class State:
    """What is known after a reading."""

    zero_mm: FloatArray
    """What is taken off each channel, shape (channels,)."""
    calm: int = 0
    """Readings since anything happened."""

    def disturbed(self) -> "State":
        """Return the state after something has happened, such as a gap in the readings."""
        return State(self.zero_mm)


def fresh(channels: int) -> State:
    """Return the state that has seen nothing."""
    return State(np.zeros(channels))


def track(deflection: FloatArray, state: State, rules: Rules) -> tuple[FloatArray, State]:
    """Return what is to be taken off each deflection [mm], and the state after them.

    A zero depends on the readings before its own only, and is the same for any split of the stream. Moving by the sign
    of what is left, it follows the median, which a few odd readings do not move.

    Parameters
    ----------
    deflection
        As calibrated [mm], shape (readings, channels), oldest first; NaN where a channel is not good.
    state
        After the readings before these.
    rules
        When the zeros may move, and how far.
    """
    zeros = np.empty_like(deflection)
    zero, calm = state.zero_mm, state.calm
    for row, value in enumerate(deflection):
        zeros[row] = zero
        left = value - zero
        if not np.all(np.abs(left) <= rules.band_mm):  # NaN, a channel that is not good, is not within the band either
            calm = 0
            continue
        calm += 1
        if calm >= rules.calm:
            moved = zero + np.clip(left, -rules.step_mm, rules.step_mm)
            zero = np.clip(moved, -rules.most_mm, rules.most_mm)
    return zeros, State(zero, calm)
