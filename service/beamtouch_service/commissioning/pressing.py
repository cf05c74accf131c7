"""Finds presses in consecutive samples: rest, a press that is held, the lift. Pure: no clock.

It looks at how far the channels moved from where they rested, and at nothing that the model says: with a wrong wiring,
the state of the surface is unexplained, but the deflections are there. The value of a channel that is not good counts
as well, where its sender has one: an inverted sensor may be out of its range, and still move.
"""

from collections import deque
from enum import StrEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

HOLD_US = 1_000_000
"""A beam rests, and a press is held, if it is so for this long by the sender's clock."""
STILL = 12.0
"""Largest spread of a channel at rest, in deviations of its noise. Half of the channels must keep to it: a broken cable
may pick up anything."""
PRESSED = 10.0
"""The beam is pressed where a channel has moved by more than this many deviations."""
STEADY = 0.5
"""A press is held while it moves the channels by at least this part of the most that it did."""
LIFTED = 0.2
"""A press is over once the channels are back to this part of it."""


class Stage(StrEnum):
    """What is awaited."""

    REST = "rest"
    """That nothing touches the beam."""
    PRESS = "press"
    HOLD = "hold"
    """That the press goes on."""
    LIFT = "lift"


class Movement(NamedTuple):
    """How the channels moved in a press that was held."""

    moved_mm: Floats
    """(channels,) from rest; 0 for a channel without values."""
    noise_mm: Floats
    """Standard deviation of these (channels,)."""


class _Entry(NamedTuple):
    """A sample."""

    at_us: int
    values_mm: Floats
    size: float
    """How far the channels are from rest, in deviations of the one that moved most."""


class PressFinder:
    """Follows the samples of one sender."""

    def __init__(self, reading_mm: float, pause_us: float) -> None:
        """Begin with nothing known.

        Parameters
        ----------
        reading_mm : noise of a reading, by the model
        pause_us : after a longer pause between two samples, what was before counts for nothing
        """
        self.stage = Stage.REST
        self._reading_mm, self._pause_us = reading_mm, pause_us
        self._window = deque[_Entry]()
        self._rest_mm = self._noise_mm = np.zeros(0)
        """Where the channels rested, and the standard deviation of their values there, that of a reading at least."""
        self._pressed = 0.0
        """How far the last press moved the channels, in deviations."""

    @property
    def held(self) -> float:
        """Which part of the time has passed for which a press must be held, 0 to 1."""
        if self.stage is not Stage.HOLD or not self._window:
            return 0.0
        return min(1.0, (self._window[-1].at_us - self._window[0].at_us) / HOLD_US)

    def forget(self) -> None:
        """Begin anew, as with another sender, whose rest may be another."""
        self.stage = Stage.REST
        self._window.clear()

    def add(self, at_us: int, values_mm: Floats, *, is_touched: bool = False) -> Movement | None:
        """Take the next sample; return a movement once a press has been held for long enough.

        Parameters
        ----------
        at_us : its time by the sender's clock [us since 1970]
        values_mm : deflections (channels,), NaN for a channel without one
        is_touched : whether the surface says that something touches it; then it is not at rest
        """
        if self._window and not 0 < at_us - self._window[-1].at_us <= self._pause_us:
            self._window.clear()
            self.stage = Stage.PRESS if self.stage is Stage.HOLD else self.stage
        entry = _Entry(at_us, values_mm, self._size(values_mm))
        if (self.stage, entry.size > PRESSED) in {(Stage.PRESS, True), (Stage.HOLD, False)}:
            self.stage = Stage.HOLD if self.stage is Stage.PRESS else Stage.PRESS
            self._window.clear()
        self._window.append(entry)
        while len(self._window) > 1 and at_us - self._window[1].at_us >= HOLD_US:
            self._window.popleft()
        if at_us - self._window[0].at_us < HOLD_US:
            return None
        if self.stage is Stage.HOLD:
            return self._take_press()
        values = np.array([one.values_mm for one in self._window])
        if self._rests(values, is_touched=is_touched):
            self._take_rest(values)
        return None

    def _size(self, values_mm: Floats) -> float:
        if self.stage is Stage.REST:
            return 0.0
        return float(np.nanmax(np.abs(values_mm - self._rest_mm) / self._noise_mm, initial=0.0))

    def _take_press(self) -> Movement | None:
        """Return the movement of the press in the window, unless its force has changed too much."""
        sizes = [one.size for one in self._window]
        if min(sizes) < STEADY * max(sizes):
            return None
        moved_mm = np.array([one.values_mm for one in self._window]).mean(axis=0) - self._rest_mm
        self.stage, self._pressed = Stage.LIFT, max(sizes)
        self._window.clear()
        return Movement(np.nan_to_num(moved_mm), self._noise_mm)

    def _rests(self, values_mm: Floats, *, is_touched: bool) -> bool:
        """Return whether the beam rests with these values (samples, channels).

        Later rests are known by the first one, whatever the surface says.
        """
        spread = values_mm.max(axis=0) - values_mm.min(axis=0)
        if np.count_nonzero(spread <= STILL * self._reading_mm) * 2 < values_mm.shape[1]:
            return False
        if self.stage is Stage.REST:
            return not is_touched
        return self.stage is Stage.PRESS or self._size(values_mm.mean(axis=0)) <= LIFTED * self._pressed

    def _take_rest(self, values_mm: Floats) -> None:
        """Note where the channels rest now: between presses, zeros may drift."""
        self._rest_mm = values_mm.mean(axis=0)
        self._noise_mm = np.maximum(self._reading_mm, np.nan_to_num(values_mm.std(axis=0)))
        self.stage = Stage.PRESS
