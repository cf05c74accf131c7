"""Recording known loads for a calibration: `beamtouch-daemon record`."""

import asyncio
import csv
import time
from collections import deque
from collections.abc import Awaitable, Callable, Iterator, Sequence
from contextlib import aclosing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TextIO

from beamtouch_daemon import tare
from beamtouch_daemon.calibration import Calibration
from beamtouch_daemon.config import ConfigError, Surface
from beamtouch_daemon.pipeline import Pipeline, Taken, counts_of
from beamtouch_daemon.sources import source_of
from beamtouch_daemon.sources.reading import Reading, Source
from beamtouch_daemon.tasks import cancel

SETTLED_S = 0.5
"""So long no channel may have moved before a load is recorded."""
MIN_READINGS = 20
GIVE_UP_S = 30.0
LOAD_COLUMNS = ("unix_time_s", "load", "position_mm", "force_n")
CHANNEL_COLUMNS = ("counts", "deflection_mm", "quality")


@dataclass(frozen=True)
class Load:
    """A known load, as the person at the beam says."""

    position_mm: float
    force_n: float


class NotSettledError(Exception):
    """The surface moved, or a channel was not good, all the time; the text says which."""


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

    async def record(self, seconds: float, keep: Callable[[Taken], None]) -> int:
        """Wait until the surface has settled, then pass on the samples of so long; returns how many.

        Where readings are late or missing it takes longer, `GIVE_UP_S` at most.

        Raises
        ------
        NotSettledError
            It did not settle within `GIVE_UP_S`.
        """
        self._recent.clear()
        await self._settled()
        self._arrived, self._keeps, number = [], True, 0
        enough = round(seconds * self._rate_hz)
        deadline_s = time.monotonic() + seconds + GIVE_UP_S
        try:
            while number < enough and (left_s := deadline_s - time.monotonic()) > 0:
                await self._wait(left_s)
                for taken in self._arrived:
                    keep(taken)
                    number += 1
                self._arrived = []
        finally:
            self._keeps = False
        return number

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
        raise NotSettledError(message)

    async def _wait(self, seconds: float) -> None:
        self._changed.clear()
        try:
            await asyncio.wait_for(self._changed.wait(), seconds)
        except TimeoutError:
            return


class Table:
    """The CSV file: a row per sample, complete in the file as soon as it is written."""

    def __init__(self, file: TextIO, channels: Sequence[str], loads: int) -> None:
        self._writer = csv.writer(file, lineterminator="\n")
        self._file = file
        self._channels = channels
        self.loads = loads
        """How many are in the file."""
        self.rows = 0

    def header(self) -> list[str]:
        """Return the column names."""
        return [*LOAD_COLUMNS, *(f"{name}_{column}" for name in self._channels for column in CHANNEL_COLUMNS)]

    def write_header(self) -> None:
        """Begin the file."""
        self._writer.writerow(self.header())
        self._file.flush()

    def write(self, load: Load, taken: Taken) -> None:
        """Add a sample of a load that is not counted yet."""
        sample = taken.sample
        cells: list[object] = [f"{sample.acquired_unix_us / 1e6:.6f}", self.loads + 1, load.position_mm, load.force_n]
        for count, value, quality in zip(taken.reading.counts, sample.deflection_mm, sample.quality, strict=True):
            cells += ["" if count is None else f"{count:.10g}", "" if value is None else f"{value:.7g}", quality.value]
        self._writer.writerow(cells)
        self._file.flush()
        self.rows += 1


@contextmanager
def table(path: Path, channels: Sequence[str], *, append: bool) -> Iterator[Table]:
    """Open a CSV file to record to.

    Raises
    ------
    ConfigError
        It is there already and is not to be appended to, has other columns, or cannot be written.
    """
    try:
        if append and path.exists():
            with path.open("r+", newline="", encoding="utf-8") as file:
                rows = list(csv.reader(file))
                made = Table(file, channels, max((int(row[1]) for row in rows[1:] if len(row) > 1), default=0))
                if not rows or rows[0] != made.header():
                    message = f"{path}: has other columns than this surface; write to another file"
                    raise ConfigError(message)
                yield made
            return
        with path.open("x", newline="", encoding="utf-8") as file:
            made = Table(file, channels, 0)
            made.write_header()
            yield made
    except FileExistsError:
        message = f"{path}: is there already; add --append, or name another file"
        raise ConfigError(message) from None
    except (ValueError, UnicodeDecodeError):
        message = f"{path}: is not a recording; write to another file"
        raise ConfigError(message) from None
    except OSError as error:
        message = f"{path}: {error.strerror}"
        raise ConfigError(message) from None


async def record_loads(
    recorder: Recorder,
    to: Table,
    next_load: Callable[[int], Awaitable[Load | None]],
    seconds: float,
    say: Callable[[str], None],
) -> None:
    """Record the loads that `next_load` gives, until it gives None; SourceError where the source fails."""
    following = asyncio.ensure_future(recorder.follow())

    async def loads() -> None:
        while (load := await next_load(to.loads + 1)) is not None:
            try:
                samples = await recorder.record(seconds, lambda taken: to.write(load, taken))
            except NotSettledError as error:
                say(f"{load.force_n:g} N at {load.position_mm:g} mm left out: {error}")
                continue
            to.loads += 1
            say(f"load {to.loads}: {load.force_n:g} N at {load.position_mm:g} mm, {samples} samples")

    recording = asyncio.ensure_future(loads())
    try:
        await asyncio.wait({following, recording}, return_when=asyncio.FIRST_COMPLETED)
        if following.done() and not recording.done():
            following.result()
        await recording
    finally:
        await cancel((recording, following))
