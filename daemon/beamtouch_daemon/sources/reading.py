"""The common parts of all sources: readings, errors, and the schedule of polled sources."""

import asyncio
import math
from collections.abc import AsyncGenerator, Mapping
from contextlib import AbstractContextManager, aclosing
from typing import NamedTuple, Protocol

from beamtouch_common.uptime import uptime_s
from beamtouch_daemon.sources.requests import Failure, Requests


class SourceError(Exception):
    """The source failed, and a new session must be begun.

    Parameters
    ----------
    reason : One line for the log, the same each time.
    observed : What came from the device instead of readings, which may differ each time.
    """

    def __init__(self, reason: str, observed: str = "") -> None:
        super().__init__(reason, observed)
        self.reason, self.observed = reason, observed

    def __str__(self) -> str:
        return "; ".join(filter(None, (self.reason, self.observed)))


class NoAnswerError(Exception):
    """A unit did not answer, or not as it should.

    Parameters
    ----------
    text : One line for the log.
    failure : What became of the request, as `Requests` counts it.
    """

    def __init__(self, text: str, failure: str = Failure.SILENT) -> None:
        super().__init__(text)
        self.failure = failure


class Reading(NamedTuple):
    """Raw counts of all channels at one instant; means of several conversions may have fractions."""

    monotonic_s: float
    """Time of its acquisition by the clock of `uptime_s`, which is monotonic and includes sleep."""
    counts: tuple[float | None, ...]
    """One per channel, in the order of the configuration; None if the device did not send it."""
    lost: int = 0
    """Readings lost between this one and the one before it in the same session."""
    failed: int = 0
    """Those of them that were lost because requests failed, and not because the device is slower than configured."""
    taken_s: float | None = None
    """Most likely time of its acquisition, by the same clock; within a session it may be off by a constant. NaN if that
    is not known well enough to follow a beam that rings; None if `monotonic_s` is the best estimate."""

    @property
    def likely_s(self) -> float:
        """Most likely time: `taken_s`, or `monotonic_s` where that is None."""
        return self.monotonic_s if self.taken_s is None else self.taken_s


class Source(Protocol):
    """Yields the readings of one surface."""

    @property
    def limits(self) -> tuple[str, ...]:
        """Known cases in which old or foreign readings may pass unnoticed, a sentence each."""
        ...

    @property
    def requests(self) -> Mapping[str, Requests]:
        """Outcomes of the requests to each unit, by its name; none if the device sends by itself."""
        ...

    def readings(self) -> AsyncGenerator[list[Reading], None]:
        """Open the device and yield non-empty lists of readings, oldest first, until SourceError.

        Closing the generator closes the device. A new call then begins the next session.
        """
        ...

    def kept_open(self) -> AbstractContextManager[None]:
        """Let a port stay open between the sessions in the block, because opening it resets many devices."""
        ...


async def first_readings(source: Source, number: int) -> list[Reading]:
    """Return the first `number` readings of a new session; SourceError if the source fails."""
    readings: list[Reading] = []
    async with aclosing(source.readings()) as stream:
        async for arrived in stream:
            readings += arrived
            if len(readings) >= number:
                break
    return readings[:number]


class Schedule:
    """Slots at a fixed rate: slot k begins at start + k / rate, so that errors do not accumulate.

    Parameters
    ----------
    rate_hz : Slots per second.
    start_s : Beginning of slot 0, by the clock of `uptime_s`.
    """

    def __init__(self, rate_hz: float, start_s: float) -> None:
        self._rate_hz = rate_hz
        self._start_s = start_s
        self._slot = -1

    def advance(self, now_s: float) -> tuple[float, int]:
        """Take the next slot; return how long to wait for it [s] and how many slots were missed before it.

        A slot that has begun is used at once; slots that are over are skipped.
        """
        reached = math.floor((now_s - self._start_s) * self._rate_hz)
        following = self._slot + 1
        self._slot = max(following, reached)
        begins_s = self._start_s + self._slot / self._rate_hz
        return max(0.0, begins_s - now_s), self._slot - following

    async def wait(self) -> int:
        """Wait for the next slot and return how many were missed before it."""
        delay_s, missed = self.advance(uptime_s())
        if delay_s > 0:
            await asyncio.sleep(delay_s)
        return missed
