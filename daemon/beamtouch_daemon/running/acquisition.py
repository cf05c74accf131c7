"""Reads one surface and puts its samples into the log, across any number of sessions with its device."""

import asyncio
import logging
import math
import time
from collections.abc import Sequence
from contextlib import aclosing

from beamtouch_common.digits import digits
from beamtouch_common.log_lines import Repeated
from beamtouch_common.units import fine
from beamtouch_common.uptime import uptime_s
from beamtouch_common.waits import Backoff
from beamtouch_daemon.config.settings import Surface
from beamtouch_daemon.delivery.boots import Boot
from beamtouch_daemon.processing.pipeline import Pipeline, TimedSample
from beamtouch_daemon.processing.rate import RateMeter
from beamtouch_daemon.running.kept_zeros import SurfaceZeros, surface_zeros
from beamtouch_daemon.sources.reading import Reading, Source, SourceError
from beamtouch_service.samples import Note, Quality

NEXT_SESSION_S = 0.5
"""Longest wait before the next session with a source; it costs other users nothing."""
MAX_UNPROCESSED = 64
"""At most this many readings wait to become samples. More at once would not take less time for each."""
MAX_PAUSE_S = 0.005
"""A device that sends by itself is read this often or once per batch, whichever is more often: a thousand looks a
second would take more than what is looked at. Buffers of drivers hold what comes meanwhile, also at 1 Mbit/s."""
PATIENCE_S = 15.0
PATIENCE_PERIODS, PATIENCE_TIMEOUTS = 20.0, 40.0
"""A surface without progress for this time, this number of reading periods and this number of timeouts of its source
hangs. A device may boot for 8 s. A serial unit that was given up rests for 13 timeouts, and is then proven again in up
to 20."""
STALE_PART = 0.2
"""A sample at rest is followed by another one within this part of the time after which it is stale: a live batch is
not repeated, and some may be lost."""
_logger = logging.getLogger(__name__)


class Acquisition:
    """Reads one surface.

    Parameters
    ----------
    name, surface : Name of the surface, and its configuration.
    source, pipeline, boot : Where the readings come from, what makes samples of them, and where these go.
    batch_s, rest_s : Time to collect readings for one batch, and from one sample to the next while nothing happens [s].
    is_tared : Whether the rest gaps are measured, rather than those of the configuration.
    """

    def __init__(
        self,
        name: str,
        surface: Surface,
        source: Source,
        pipeline: Pipeline,
        boot: Boot,
        batch_s: float,
        rest_s: float,
        *,
        is_tared: bool = True,
    ) -> None:
        self.name = name
        self.is_tared = is_tared
        self.surface = surface
        self.boot = boot
        self.readings = 0
        """Number of readings since the start."""
        self.lost = 0
        """Due, but not taken, or not processed because of an unexpected error."""
        self.is_missing = True
        """No reading comes: the device is not there yet, or gone."""
        self.last_s: float | None = None
        """Time of the newest reading, by the clock of `uptime_s`."""
        self.last_progress_s = time.monotonic()
        """Time of the last progress on the monotonic clock: a reading, or a session that ended with an error."""
        self.quality: list[Quality] = []
        """Quality of each channel in the newest sample; empty before the first."""
        self.meter = RateMeter(surface.rate_hz, is_polled=surface.source.is_polled)
        """Measures the rate of the readings."""
        self.source = source
        self._pipeline = pipeline
        self._batch_s, self._rest_s = batch_s, rest_s
        self._pause_s = 0.0 if surface.source.is_polled else min(batch_s, MAX_PAUSE_S)
        self._sampled_s = -math.inf
        """Time of the newest reading that became a sample, by the clock of `uptime_s`."""
        self._rests = False
        """True if nothing happens, as the debug log says."""
        self._is_far = self._is_hurried = False
        """True if zeros are far from the last tare, as it was logged."""
        self._unprocessed: list[Reading] = []
        """The newest readings. They become samples once per batch: a few together take about as long as one."""
        self._discarded = 0
        """Readings before the next one that an unexpected error kept from the pipeline, and those lost before them."""
        self._arrived = asyncio.Event()
        self._backoff = Backoff(max_s=NEXT_SESSION_S)
        self._repeated = Repeated(_logger, name)
        self._unreliable = {unit: Repeated(_logger, name) for unit in source.requests}

    @property
    def zeros(self) -> SurfaceZeros | None:
        """Its zeros, to be kept over a restart; None if nothing is known of them."""
        return surface_zeros(self.boot.log.head.characteristic, self._pipeline.rested, self._pipeline.last_s)

    def hangs(self, now_s: float) -> bool:
        """Return whether the source hangs at `now_s` on the monotonic clock: no reading comes, and no error either."""
        periods_s = PATIENCE_PERIODS / self.surface.rate_hz
        timeouts_s = PATIENCE_TIMEOUTS * self.surface.source.timeout_s
        return now_s - self.last_progress_s > PATIENCE_S + periods_s + timeouts_s

    async def read(self) -> None:
        """Read until cancelled; a session that fails is followed by another one, on the same port if that works."""
        self.last_progress_s = time.monotonic()  # an unexpected error ended it, and some time has passed
        with self.source.kept_open():
            while True:
                self.meter.restart()
                try:
                    async with aclosing(self.source.readings()) as stream:
                        async for readings in stream:
                            self._take(readings)
                            if self._pause_s:
                                await asyncio.sleep(self._pause_s)
                except SourceError as error:
                    self._repeated.failed(f"{error}; trying again", error.reason)
                finally:
                    self.is_missing = True
                self._arrived.set()  # what waited at rest waits for no other reading
                self.last_progress_s = time.monotonic()
                await asyncio.sleep(self._backoff.next())

    async def run(self) -> None:
        """Make samples of the readings, once for each live batch, until cancelled."""
        while True:
            await self._arrived.wait()
            self.process()
            self.boot.wake_live()
            await asyncio.sleep(self._batch_s - self._pause_s)

    def process(self) -> None:
        """Put the samples of all readings so far into the log."""
        self._arrived.clear()
        readings, self._unprocessed = self._unprocessed, []
        if not readings:
            return
        readings[0] = readings[0]._replace(lost=readings[0].lost + self._discarded)
        notes = () if self.meter.fits else (Note.RATE,)
        try:
            samples = self._pipeline.process(readings, time.time() - uptime_s(), notes)
        except Exception:
            self._discarded = len(readings) + sum(reading.lost for reading in readings)
            self.lost += len(readings)
            raise
        self._discarded = 0
        if samples:
            if _logger.isEnabledFor(logging.DEBUG):
                self._debug_changes(samples)
            self.quality = samples[-1].sample.quality
            self._sampled_s = samples[-1].monotonic_s
            self.boot.put(samples)
        self._warn_of_drift()
        self._warn_of_hurry()

    def _debug_changes(self, samples: Sequence[TimedSample]) -> None:
        """Write to the debug log which channels changed, and whether the beam began to move or to rest."""
        before: Sequence[Quality | None] = self.quality or [None] * len(self.surface.channel_names)
        for taken in samples:
            now = taken.sample.quality
            channels = zip(self.surface.channel_names, before, now, strict=True)
            if changes := [f"{channel} is {new}" for channel, old, new in channels if new != old]:
                _logger.debug("%s: sample %d: %s", self.name, taken.sample.sequence, ", ".join(changes))
            before = now
        rests = self._pipeline.most_waiting > 0
        if rests != self._rests:
            self._rests = rests
            words = "one sample for each reading"
            if rests:
                words = "nothing happens: few samples, each the mean of all readings"
            _logger.debug("%s: sample %d: %s", self.name, samples[-1].sample.sequence, words)

    def _warn_of_drift(self) -> None:
        """Log once that zeros are nearly as far from the last tare as is followed, and that they are back."""
        far_mm, tracking = self._pipeline.far_zero_mm, self.surface.zero_tracking
        if tracking is None or (far_mm is not None) == self._is_far:
            return
        self._is_far = far_mm is not None
        if far_mm is None:
            _logger.info("%s: its zeros are near the last tare again", self.name)
        else:
            words = (
                "%s: its zeros have drifted by up to %s since the last tare; no more than %s are followed: "
                "wait until it no longer warms or cools, take everything off the beam, and tare"
            )
            far, most = (fine(size_mm, self.surface.value_unit) for size_mm in (far_mm, tracking.max_mm))
            _logger.warning(words, self.name, far, most)

    def _warn_of_hurry(self) -> None:
        """Log once that a zero drifts faster than is stated, and that none does any more."""
        hurried, tracking = self._pipeline.hurried_zero, self.surface.zero_tracking
        if tracking is None or (hurried is not None) == self._is_hurried:
            return
        self._is_hurried = hurried is not None
        if hurried is None:
            _logger.info("%s: its zeros again drift no faster than stated", self.name)
            return
        um_per_min = 1e3 * hurried.mm_per_min
        who, look = "its zeros drift", ""
        if not hurried.is_common:
            who = f"the zero of {self.surface.channel_names[hurried.channel]} drifts"
            look = "look at this sensor and its bracket, or "
        _logger.warning(
            "%s: %s at %s/min, %s times what is stated, and answers will soon be wrong: %sstate the drift of the "
            "hall in zero_tracking.drift_um_per_min; a load laid on very slowly looks the same",
            self.name,
            who,
            f"{'+' if um_per_min > 0 else ''}{fine(hurried.mm_per_min, self.surface.value_unit, 2)}",
            digits(abs(um_per_min) / tracking.drift_um_per_min, 2),
            look,
        )

    def _take(self, readings: list[Reading]) -> None:
        if self.is_missing:
            readings[0] = self._resume(readings[0])
        self.readings += len(readings)
        lost, failed = sum(reading.lost for reading in readings), sum(reading.failed for reading in readings)
        self.lost += lost
        self._repeated.count(failed, "readings lost since the last such line, as requests fail")
        others = "readings lost since the last such line, by the device, the line or a busy machine"
        self._repeated.count(lost - failed, others)
        self.last_s = readings[-1].monotonic_s
        self.last_progress_s = time.monotonic()
        if self.meter.add(readings):
            _logger.log(logging.INFO if self.meter.fits else logging.WARNING, "%s: %s", self.name, self.meter)
        self._report_requests()
        self._unprocessed += readings
        if self._may_wait(readings):
            return
        if len(self._unprocessed) >= MAX_UNPROCESSED:
            self.process()
        self._arrived.set()

    def _report_requests(self) -> None:
        """Log if some of the requests to a unit fail, and once they no longer do."""
        for unit, requests in self.source.requests.items():
            if requests.failed_share:
                self._unreliable[unit].failed(requests.describe(unit), "requests")
            else:
                self._unreliable[unit].over(f"{unit} answers all requests again")

    def _may_wait(self, readings: list[Reading]) -> bool:
        """Return whether new readings say no more than the newest sample, and that sample is not due to be followed.

        How long an answer may stand on it, only a receipt says.
        """
        stale_s = self.boot.pace.stale_s
        if len(self._unprocessed) > self._pipeline.most_waiting or stale_s is None:
            return False
        if readings[-1].monotonic_s - self._sampled_s >= min(self._rest_s, STALE_PART * stale_s):
            return False
        return all(self._pipeline.explains(reading) for reading in readings)

    def _resume(self, reading: Reading) -> Reading:
        """Return the first reading of a session with the number of those lost since the last one, by the clock."""
        self.is_missing = False
        self._repeated.over()
        self._backoff.reset()
        if self.last_s is None:
            _logger.info("%s: reading", self.name)
            return reading
        lost = max(0, round((reading.monotonic_s - self.last_s) * self.surface.rate_hz) - 1)
        return reading._replace(lost=lost, failed=0)
