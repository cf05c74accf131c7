"""Recording known loads for a calibration: `beamtouch-daemon record`.

What is recorded is believed by `calibrate`. So a load has to be one that the surface may carry, to be seen, and to be
still for as long as it is recorded. A person who knows better may have it recorded all the same.
"""

import asyncio
import time
from collections import deque
from collections.abc import Sequence
from contextlib import aclosing
from typing import Protocol

import numpy as np

from beamtouch_daemon.commands.record_table import Load, Table
from beamtouch_daemon.config import settings as config
from beamtouch_daemon.config.settings import Surface
from beamtouch_daemon.processing import tare
from beamtouch_daemon.processing.characteristic import QUALITIES, Calibration
from beamtouch_daemon.processing.pipeline import Pipeline, Taken, counts_of
from beamtouch_daemon.sources import source_of
from beamtouch_daemon.sources.reading import Reading, Source
from beamtouch_daemon.tasks import cancel
from beamtouch_service.samples import Quality

SETTLED_S = 0.5
"""So long no channel may have moved before a load is recorded."""
MIN_READINGS = 20
GIVE_UP_S = 30.0
SEEN = 3.0
"""A load is seen where it deflects a channel by more than this, over the noise of one reading."""


class LoadRefusedError(Exception):
    """The load is not recorded; the text is one line that says why."""


class TakeBack:
    """What a person gives in place of a load to have the last one removed."""


class Person(Protocol):
    """Who puts loads on the beam."""

    async def next_load(self, number: int) -> Load | TakeBack | None:
        """Return the next load once it is on the beam; None at the end."""
        ...

    def recorded(self, load: Load, text: str) -> None:
        """Hear that a load was recorded."""
        ...

    def refused(self, load: Load, reason: str) -> None:
        """Hear that a load was not recorded."""
        ...

    def say(self, text: str) -> None:
        """Hear something else."""
        ...


def require_stated(load: Load, known: config.Loads | None) -> None:
    """Raise LoadRefusedError if the surface cannot have such a load by its configuration."""
    if known is None or load.is_accepted:
        return
    low, high = known.position_mm
    if not low <= load.position_mm <= high:
        message = f"{load.position_mm:g} mm is not within {low:g} to {high:g} mm, where the model knows loads"
        raise LoadRefusedError(message)
    if load.force_n > known.most_force_n:
        message = f"{load.force_n:g} N is more than {known.most_force_n:g} N, the most that the model knows"
        raise LoadRefusedError(message)


class Recorder:
    """Follows a surface, so that its filter never starts anew, and keeps the samples of a load when asked to."""

    def __init__(self, surface: Surface, rest_gap_mm: dict[str, float]) -> None:
        self._channels = surface.channel_names
        self._noise_mm = surface.noise_mm
        self._rate_hz = surface.rate_hz
        self._source: Source = source_of(surface)
        self._calibration = Calibration.of(surface.channels, rest_gap_mm)
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
                taken = self._pipeline.process(readings, time.time() - time.monotonic())
                self._recent.extend(readings)
                if self._keeps:
                    self._arrived += taken
                self._changed.set()

    async def record(self, load: Load, seconds: float) -> list[Taken]:
        """Wait until the surface has settled, then return the samples of so long.

        Where readings are late or missing it takes longer, `GIVE_UP_S` at most.

        Raises
        ------
        LoadRefusedError
            It did not settle within `GIVE_UP_S`, moved while it was recorded, or no load is seen.
        """
        self._recent.clear()
        if not load.is_accepted:
            await self._settled()
        self._arrived, self._keeps = [], True
        enough = round(seconds * self._rate_hz)
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
        gaps, good = self._calibration.gap(counts), self._calibration.quality(counts) == QUALITIES.index(Quality.GOOD)
        seen, largest = False, (0.0, "", 0.0)
        for index, (name, step) in enumerate(zip(self._channels, self._calibration.steepest.tolist(), strict=True)):
            gap = gaps[good[:, index], index]
            if len(gap) < 2:
                continue
            if moved := tare.motion(gap, step, self._noise_mm):
                message = f"it moved while it was recorded: {name}, {moved}"
                raise LoadRefusedError(message)
            deflection, noise = (
                abs(self._calibration.rest_gap[index] - np.mean(gap)),
                tare.noise_of(gap, self._noise_mm),
            )
            seen = seen or deflection > SEEN * noise + step
            largest = max(largest, (float(deflection), name, noise))
        if not seen:
            deflection, name, noise = largest
            message = f"no load is seen: the largest deflection is {deflection:.2g} mm ({name}), noise {noise:.2g} mm"
            raise LoadRefusedError(message)

    async def _settled(self) -> None:
        deadline_s, refusal = time.monotonic() + GIVE_UP_S, "no readings came"
        while (left_s := deadline_s - time.monotonic()) > 0:
            await self._wait(left_s)
            if len(self._recent) < (self._recent.maxlen or 0):
                continue
            try:
                tare.rest_gaps(counts_of(list(self._recent)), self._calibration, self._channels, self._noise_mm)
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


async def record_loads(recorder: Recorder, to: Table, person: Person, seconds: float) -> None:
    """Record the loads that a person gives, until there are no more; SourceError where the source fails."""
    following = asyncio.ensure_future(recorder.follow())
    recording = asyncio.ensure_future(_record_loads(recorder, to, person, seconds))
    try:
        await asyncio.wait({following, recording}, return_when=asyncio.FIRST_COMPLETED)
        if following.done() and not recording.done():
            following.result()
        await recording
    finally:
        await cancel((recording, following))


async def _record_loads(recorder: Recorder, to: Table, person: Person, seconds: float) -> None:
    while (load := await person.next_load(to.loads + 1)) is not None:
        if isinstance(load, TakeBack):
            number, gone = to.loads, to.take_back()
            person.say("there is no load to take back" if gone is None else f"load {number}, {gone}, is taken back")
            continue
        try:
            samples = await recorder.record(load, seconds)
        except LoadRefusedError as error:
            person.refused(load, str(error))
        else:
            to.write(load, samples)
            person.recorded(load, f"load {to.loads}: {load}, {len(samples)} samples")
