"""What every source gives, and the clock that polled sources keep."""

import asyncio
import math
from collections.abc import AsyncGenerator
from time import monotonic
from typing import NamedTuple, Protocol


class SourceError(Exception):
    """The source cannot go on and has to be opened anew; the text is one line for the log."""


class NoAnswerError(Exception):
    """A unit did not answer, or not intact; the text is one line for the log.

    Parameters
    ----------
    message
        The text.
    lives
        Whether the unit has just answered something else.
    """

    def __init__(self, message: str, *, lives: bool = False) -> None:
        super().__init__(message)
        self.lives = lives


class Reading(NamedTuple):
    """Raw counts of all channels at one instant; the mean of several conversions need not be whole."""

    monotonic_s: float
    """When it was taken, on the monotonic clock of this host."""
    counts: tuple[float | None, ...]
    """One per channel, in the order of the configuration; None for a channel that the device did not give."""
    lost: int = 0
    """Readings lost between this one and the one before it in the same session."""


class Source(Protocol):
    """Where the readings of one surface come from."""

    @property
    def limits(self) -> tuple[str, ...]:
        """What cannot be proven of the readings, as far as is known by now; a sentence each."""
        ...

    def readings(self) -> AsyncGenerator[list[Reading], None]:
        """Open the device and yield readings, oldest first, never an empty list, until SourceError.

        Closing the generator closes the device. It may be called again afterwards, for the next session.
        """
        ...


class Schedule:
    """Slots at a fixed rate: slot k begins at start + k / rate, so that nothing adds up.

    Parameters
    ----------
    rate_hz
        Slots per second.
    start_s
        Beginning of slot 0, on the monotonic clock.
    """

    def __init__(self, rate_hz: float, start_s: float) -> None:
        self._rate_hz = rate_hz
        self._start_s = start_s
        self._slot = -1

    def advance(self, now_s: float) -> tuple[float, int]:
        """Take the next slot; return how long to wait for it [s] and how many slots were missed before it.

        A slot that has begun is used at once; slots that have passed altogether are skipped, not caught up.
        """
        reached = math.floor((now_s - self._start_s) * self._rate_hz)
        following = self._slot + 1
        self._slot = max(following, reached)
        begins_s = self._start_s + self._slot / self._rate_hz
        return max(0.0, begins_s - now_s), self._slot - following

    async def wait(self) -> int:
        """Wait for the next slot and return how many were missed before it."""
        delay_s, missed = self.advance(monotonic())
        if delay_s > 0:
            await asyncio.sleep(delay_s)
        return missed
