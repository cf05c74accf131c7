"""Finds presses in consecutive samples: rest, a press that is held, the lift. Pure: no clock.

It looks at how far the channels moved from where they rested. What the surface says only shows when they do not rest:
with a wrong wiring it is unexplained, but the deflections are there. A press counts once the beam is back where it
rested before; otherwise a load that is taken off would be a press with the wrong sign. The value of a channel that is
not good counts as well, where its sender has one: an inverted sensor may be out of its range, and still move.
"""

from collections import deque
from collections.abc import Iterable
from enum import StrEnum
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from beamtouch_models.runtime import State

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
SETTLED_US = 10_000_000
"""A beam that lies still for this long rests there, although it is elsewhere than before a press, or the surface does
not call it clear. A person who is told to lift, or to take everything off, does so earlier."""


class Stage(StrEnum):
    """The awaited action."""

    REST = "rest"
    """Nothing should touch the beam."""
    PRESS = "press"
    HOLD = "hold"
    """The press should go on."""
    LIFT = "lift"


class Movement(NamedTuple):
    """The movement of the channels in a press that was held."""

    moved_mm: Floats
    """(channels,) from rest; NaN for a channel with values in less than half of the samples."""
    noise_mm: Floats
    """Standard deviation of these (channels,)."""


class _Entry(NamedTuple):
    """A sample."""

    at_us: int
    values_mm: Floats


class _Summary(NamedTuple):
    """Values of some samples, each (channels,); NaN for a channel with values in less than half of them."""

    mean_mm: Floats
    deviation_mm: Floats
    spread_mm: Floats
    """Largest less smallest value."""

    @classmethod
    def of(cls, window: Iterable[_Entry]) -> Self:
        """Return the summary of at least one sample."""
        values_mm = np.array([one.values_mm for one in window])
        is_known = np.count_nonzero(np.isfinite(values_mm), axis=0) * 2 >= len(values_mm)
        known_mm = values_mm[:, is_known]
        table = np.full((3, values_mm.shape[1]), np.nan)
        table[:, is_known] = (
            np.nanmean(known_mm, axis=0),
            np.nanstd(known_mm, axis=0),
            np.nanmax(known_mm, axis=0) - np.nanmin(known_mm, axis=0),
        )
        return cls(*table)


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
        """Rest values of the channels, and their standard deviations, each at least that of a reading."""
        self._first_rest_mm = self._rest_mm
        """Rest values of the channels when the current press began to be awaited."""
        self._movement: Movement | None = None
        """The movement of the press that awaits its lift."""
        self._pressed = 0.0
        """Largest movement of a channel by this press, in deviations."""
        self._still_since_us: int | None = None
        """Since when the beam has been still while a lift is awaited."""

    @property
    def held(self) -> float:
        """Fraction of the hold time that has elapsed, 0 to 1."""
        if self.stage is not Stage.HOLD or not self._window:
            return 0.0
        return min(1.0, (self._window[-1].at_us - self._window[0].at_us) / HOLD_US)

    def forget(self) -> None:
        """Start over, as with another sender, whose rest may be another."""
        self.stage = Stage.REST
        self._clear()

    def add(self, at_us: int, values_mm: Floats, state: State | None = None) -> Movement | None:
        """Take the next sample; return the movement of a press that was held for long enough, once it is lifted.

        Parameters
        ----------
        at_us : its time by the sender's clock [us since 1970]
        values_mm : deflections (channels,), NaN for a channel without one
        state : what the surface states; None without a state
        """
        if self._window and not 0 < at_us - self._window[-1].at_us <= self._pause_us:
            self._clear()
            if self.stage is Stage.HOLD:
                self.stage = Stage.PRESS
        self._note_press(is_pressed=self._size(values_mm) > PRESSED)
        self._window.append(_Entry(at_us, values_mm))
        while len(self._window) > 1 and at_us - self._window[1].at_us >= HOLD_US:
            self._window.popleft()
        if at_us - self._window[0].at_us < HOLD_US:
            return None
        if self.stage is Stage.HOLD:
            self._take_press()
            return None
        return self._take_still(_Summary.of(self._window), state)

    def _note_press(self, *, is_pressed: bool) -> None:
        """Go from awaiting a press to awaiting that it is held, or back."""
        if self.stage is Stage.PRESS and is_pressed:
            self.stage = Stage.HOLD
        elif self.stage is Stage.HOLD and not is_pressed:
            self.stage = Stage.PRESS
        else:
            return
        self._clear()

    def _clear(self) -> None:
        self._window.clear()
        self._still_since_us = None

    def _size(self, values_mm: Floats) -> float:
        """Return the distance of the channels from rest, in deviations of the one that moved most."""
        if self.stage is Stage.REST:
            return 0.0
        return float(np.nanmax(np.abs(values_mm - self._rest_mm) / self._noise_mm, initial=0.0))

    def _take_press(self) -> None:
        """Note the movement of the press in the window, unless its force has changed too much."""
        moved_mm = _Summary.of(self._window).mean_mm - self._rest_mm
        if np.isnan(moved_mm).all():
            return
        # Of one channel: in a sample without its value, the others would seem to be a hand that lets go.
        strongest = np.nanargmax(np.abs(moved_mm) / self._noise_mm)
        way_mm = np.array([one.values_mm[strongest] for one in self._window]) - self._rest_mm[strongest]
        sizes = (np.abs(way_mm[np.isfinite(way_mm)]) / self._noise_mm[strongest]).tolist()
        if min(sizes) < STEADY * max(sizes):
            return
        self._movement = Movement(moved_mm, self._noise_mm)
        self.stage, self._pressed = Stage.LIFT, max(sizes)
        self._clear()

    def _take_still(self, summary: _Summary, state: State | None) -> Movement | None:
        """Take what may be a rest; return the movement of the press that it ends."""
        if np.count_nonzero(summary.spread_mm <= STILL * self._reading_mm) * 2 < len(summary.spread_mm):
            self._still_since_us = None
        elif self.stage is Stage.LIFT:
            return self._take_lift(summary, state)
        elif self.stage is Stage.REST and state is State.CLEAR:
            self._begin_from(summary)
        elif self.stage is Stage.REST:
            # With a wrong wiring a load that lies on is no contact, and only what stays so is a rest.
            self._await_settled(summary, state)
        elif state not in {State.CONTACT, State.UNEXPLAINED} and self._is_near_first(summary):
            self._take_rest(summary)
        return None

    def _take_lift(self, summary: _Summary, state: State | None) -> Movement | None:
        """Return the movement of the press once the beam is back, or discard it if the beam settles elsewhere."""
        if self._size(summary.mean_mm) <= LIFTED * self._pressed:
            self._begin_from(summary)
            return self._movement
        self._await_settled(summary, state)
        return None

    def _await_settled(self, summary: _Summary, state: State | None) -> None:
        """Take the beam to rest here once it has been still for so long that nobody has just been told to let go."""
        if state is State.CONTACT:
            self._still_since_us = None
        elif self._still_since_us is None:
            self._still_since_us = self._window[0].at_us
        elif self._window[-1].at_us - self._still_since_us >= SETTLED_US:
            self._begin_from(summary)

    def _is_near_first(self, summary: _Summary) -> bool:
        """Return whether zeros may have drifted so far: a gentle press must not become the rest step by step."""
        moved_mm = np.abs(summary.mean_mm - self._first_rest_mm)
        return float(np.nanmax(moved_mm / self._noise_mm, initial=0.0)) <= PRESSED

    def _begin_from(self, summary: _Summary) -> None:
        """Await a press from this rest."""
        self.stage, self._first_rest_mm = Stage.PRESS, summary.mean_mm
        self._still_since_us = None
        self._take_rest(summary)

    def _take_rest(self, summary: _Summary) -> None:
        self._rest_mm = summary.mean_mm
        self._noise_mm = np.maximum(self._reading_mm, np.nan_to_num(summary.deviation_mm))
