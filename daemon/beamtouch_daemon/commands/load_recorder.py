"""Records the samples of one known load at a time.

`design-sensors calibrate` trusts what is recorded. So a load must be within the configured limits, it must deflect the
beam visibly, and it must not move while it is recorded. A load that the user accepts is recorded without these checks.
"""

import asyncio
import time
from collections import deque
from collections.abc import Sequence
from contextlib import aclosing

import numpy as np

from beamtouch_common.digits import digits
from beamtouch_daemon.commands.record_table import Load
from beamtouch_daemon.config.settings import Loads, Surface
from beamtouch_daemon.processing import tare
from beamtouch_daemon.processing.characteristic import QUALITIES, Characteristic
from beamtouch_daemon.processing.pipeline import Pipeline, Taken, counts_of
from beamtouch_daemon.sources.configured import source_of
from beamtouch_daemon.sources.reading import Reading, Source
from beamtouch_daemon.uptime import uptime_s
from beamtouch_service.samples import Quality

SETTLED_S = 0.5
MIN_READINGS = 20
"""All channels must be steady for the longer of this time and this number of readings before a load is recorded."""
MIN_SAMPLES = 2
"""Smallest number of samples of a load; a single one cannot show whether the load was steady."""
GIVE_UP_S = 30.0
"""Limit on waiting for a load to settle, and on recording for longer than asked when readings are lost."""
SEEN = 3.0
"""A load is seen if it deflects a channel by more than this, in standard deviations of one reading."""


class LoadRefusedError(Exception):
    """The load is not recorded; the text is one line with the reason."""


def require_stated(load: Load, known: Loads | None) -> None:
    """Raise LoadRefusedError if a load is outside the configured limits."""
    if known is None or load.is_accepted:
        return
    low, high = known.position_mm
    if not low <= load.position_mm <= high:
        message = f"{load.position_mm:g} mm is not within {low:g} to {high:g} mm, the range that the model covers"
        raise LoadRefusedError(message)
    if load.force_n > known.max_force_n:
        message = f"{load.force_n:g} N is more than {known.max_force_n:g} N, the largest force that the model covers"
        raise LoadRefusedError(message)


class LoadRecorder:
    """Reads a surface without a break, so that its filter never restarts; keeps the samples of a load on request."""

    def __init__(self, surface: Surface, rest_gap_mm: dict[str, float]) -> None:
        self._channels = surface.channel_names
        self._noise_mm = surface.noise_mm
        self._rate_hz = surface.rate_hz
        self._source: Source = source_of(surface)
        self._characteristic = Characteristic.of(surface.channels, rest_gap_mm)
        self._pipeline = Pipeline(surface, rest_gap_mm)
        needed = max(MIN_READINGS, round(SETTLED_S * surface.rate_hz))
        self._recent: deque[Reading] = deque(maxlen=needed)
        self._arrived: list[Taken] = []
        self._changed = asyncio.Event()
        self._keeps = False

    async def follow(self) -> None:
        """Read until cancelled; SourceError where the source fails."""
        async with aclosing(self._source.readings()) as stream:
            async for readings in stream:
                taken = self._pipeline.process(readings, time.time() - uptime_s())
                self._recent.extend(readings)
                if self._keeps:
                    self._arrived += taken
                self._changed.set()

    async def record(self, load: Load, seconds: float) -> list[Taken]:
        """Wait until the surface has settled, then return the samples of the next `seconds`.

        Lost readings are waited for, for up to `GIVE_UP_S`.

        Raises
        ------
        LoadRefusedError
            The surface did not settle within `GIVE_UP_S`, or the load moved, is not seen, or deflects the beam upwards.
        """
        self._recent.clear()
        if not load.is_accepted:
            await self._settled()
        self._arrived, self._keeps = [], True
        enough = max(MIN_SAMPLES, round(seconds * self._rate_hz))
        deadline_s = time.monotonic() + seconds + GIVE_UP_S
        try:
            while len(self._arrived) < enough and (left_s := deadline_s - time.monotonic()) > 0:
                await self._wait(left_s)
        finally:
            self._keeps = False
        if not load.is_accepted:
            self._require_still_and_seen([taken.reading for taken in self._arrived])
        return self._arrived

    def _require_still_and_seen(self, readings: Sequence[Reading]) -> None:
        counts = counts_of(readings) if readings else np.empty((0, len(self._channels)))
        gaps, good = (
            self._characteristic.gap(counts),
            self._characteristic.quality(counts) == QUALITIES.index(Quality.GOOD),
        )
        seen, largest = False, (0.0, "", 0.0)
        for index, (name, step) in enumerate(zip(self._channels, self._characteristic.steepest.tolist(), strict=True)):
            gap = gaps[good[:, index], index]
            if len(gap) < 2:
                continue
            if moved := tare.motion(gap, step, self._noise_mm):
                message = f"the load moved while it was recorded: {name}, {moved}"
                raise LoadRefusedError(message)
            deflection = float(self._characteristic.rest_gap[index] - np.mean(gap))
            noise = tare.noise_of(gap, self._noise_mm)
            seen = seen or abs(deflection) > SEEN * noise + step
            largest = max(largest, (deflection, name, noise), key=lambda one: abs(one[0]))
        deflection, name, noise = largest
        if not name:
            message = "no channel gave good readings"
            raise LoadRefusedError(message)
        if not seen:
            message = (
                f"no load is seen: the largest deflection is {digits(abs(deflection), 2)} mm ({name}), noise "
                f"{digits(noise, 2)} mm"
            )
            raise LoadRefusedError(message)
        if deflection < 0:
            message = (
                f"the largest deflection is negative: {digits(deflection, 2)} mm ({name}), against the load, "
                "which is right only where an overhang lifts"
            )
            raise LoadRefusedError(message)

    async def _settled(self) -> None:
        deadline_s, refusal = time.monotonic() + GIVE_UP_S, "no readings arrived"
        while (left_s := deadline_s - time.monotonic()) > 0:
            await self._wait(left_s)
            if len(self._recent) < (self._recent.maxlen or 0):
                continue
            try:
                tare.rest_gaps(counts_of(list(self._recent)), self._characteristic, self._channels, self._noise_mm)
            except tare.TareRefusedError as error:
                refusal = str(error).partition(";")[0]
            else:
                return
        message = f"not settled within {GIVE_UP_S:g} s: {refusal}"
        raise LoadRefusedError(message)

    async def _wait(self, seconds: float) -> None:
        self._changed.clear()
        try:
            await asyncio.wait_for(self._changed.wait(), seconds)
        except TimeoutError:
            return
