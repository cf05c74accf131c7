"""Reads one surface and puts its samples into the log, across any number of sessions with its device."""

import asyncio
import logging
import time
from contextlib import aclosing

from beamtouch_common.log import Repeated
from beamtouch_common.waits import Backoff
from beamtouch_daemon.config.settings import Surface
from beamtouch_daemon.config.sources import SerialLine
from beamtouch_daemon.delivery.log import Log
from beamtouch_daemon.processing import rate
from beamtouch_daemon.processing.pipeline import Pipeline
from beamtouch_daemon.sources.reading import Reading, Source, SourceError
from beamtouch_daemon.uptime import uptime_s
from beamtouch_service.samples import Note, Quality

REOPEN_S = 0.5
"""Longest wait before a source is opened again; opening costs other users nothing."""
MAX_UNPROCESSED = 64
"""At most this many readings wait to become samples. More at once would not take less time for each."""
_log = logging.getLogger(__name__)


class Acquisition:
    """Reads one surface.

    Parameters
    ----------
    name, surface
        Name of the surface, and its configuration.
    source, pipeline, log
        Where the readings come from, what makes samples of them, and where these go.
    batch_s
        Time to collect readings for one batch [s].
    """

    def __init__(
        self, name: str, surface: Surface, source: Source, pipeline: Pipeline, log: Log, batch_s: float
    ) -> None:
        self.readings = 0
        """Taken."""
        self.lost = 0
        """Due but not taken."""
        self.is_missing = True
        """No reading comes: the device is not there yet, or gone."""
        self.last_s: float | None = None
        """Time of the newest reading, by the clock of `uptime_s`."""
        self.turned_s = time.monotonic()
        """Time of the last progress on the monotonic clock: a reading, or a session that ended with an error."""
        self.quality: list[Quality] = []
        """Of each channel in the newest sample; empty before the first."""
        self._name = name
        self._rate_hz = surface.rate_hz
        self._polled = not isinstance(surface.source, SerialLine)
        self.meter = rate.RateMeter(surface.rate_hz, counts_lost=not self._polled)
        """Measures the rate of the readings."""
        self._source, self._pipeline, self._log = source, pipeline, log
        self._batch_s = batch_s
        self._unprocessed: list[Reading] = []
        """The newest readings. They become samples once per batch: a few together take about as long as one."""
        self._arrived = asyncio.Event()
        self._backoff = Backoff(max_s=REOPEN_S)
        self._repeated = Repeated(_log, name)

    async def read(self) -> None:
        """Read until cancelled; a session that fails is followed by another one."""
        while True:
            self.is_missing = True
            self.meter.restart()
            try:
                async with aclosing(self._source.readings()) as stream:
                    async for readings in stream:
                        self._take(readings)
            except SourceError as error:
                self._repeated.failed(f"{error}; trying again")
            self.turned_s = time.monotonic()
            await asyncio.sleep(self._backoff.next())

    async def run(self) -> None:
        """Make samples of the readings, once for each live batch, until cancelled."""
        while True:
            await self._arrived.wait()
            self.process()
            self._log.fresh.set()
            await asyncio.sleep(self._batch_s)

    def process(self) -> None:
        """Put the samples of all readings so far into the log."""
        self._arrived.clear()
        readings, self._unprocessed = self._unprocessed, []
        if not readings:
            return
        notes = () if self.meter.fits else (Note.RATE,)
        if samples := self._pipeline.process(readings, time.time() - uptime_s(), notes):
            self.quality = samples[-1].sample.quality
            self._log.put(samples)

    def _take(self, readings: list[Reading]) -> None:
        if self.is_missing:
            readings[0] = self._resume(readings[0])
        self.readings += len(readings)
        lost = sum(reading.lost for reading in readings)
        self.lost += lost
        self._repeated.count(lost, "readings lost")
        self.last_s = readings[-1].monotonic_s
        self.turned_s = time.monotonic()
        self._watch_rate(readings)
        self._unprocessed += readings
        if len(self._unprocessed) >= MAX_UNPROCESSED:
            self.process()
        self._arrived.set()

    def _resume(self, reading: Reading) -> Reading:
        """Return the first reading of a session with the number of those lost since the last one, by the clock."""
        self.is_missing = False
        self._repeated.over()
        self._backoff.reset()
        if self.last_s is None:
            _log.info("%s: reading", self._name)
            return reading
        return reading._replace(lost=max(0, round((reading.monotonic_s - self.last_s) * self._rate_hz) - 1))

    def _watch_rate(self, readings: list[Reading]) -> None:
        verdict = self.meter.add(readings)
        if verdict is None:
            return
        if verdict.fits:
            words = "%s: %.4g readings per second, within %g %% of rate_hz = %g"
            _log.info(words, self._name, verdict.measured_hz, 100 * rate.TOLERANCE, self._rate_hz)
        else:
            _log.warning("%s: %s", self._name, rate.complaint(verdict, self._rate_hz, polled=self._polled))
