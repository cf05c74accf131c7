"""An acquisition that is given readings, and readings for it."""

import asyncio
from collections.abc import AsyncGenerator, Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext

from beamtouch_daemon.config.settings import Surface
from beamtouch_daemon.delivery.boots import SurfaceLogs
from beamtouch_daemon.processing.filters import rest_of
from beamtouch_daemon.processing.pipeline import Pipeline
from beamtouch_daemon.running.acquisition import Acquisition
from beamtouch_daemon.sources.reading import Reading, SourceError
from beamtouch_daemon.sources.requests import Requests

from .publishing import boot
from .surfaces import RATE_HZ, surface_of

REST = 20_000.0


class Nothing:
    """A source that gives no readings, with the outcomes of requests to two units."""

    limits: tuple[str, ...] = ()

    def __init__(self) -> None:
        self.requests: Mapping[str, Requests] = {"unit 3": Requests(), "unit 4": Requests()}

    def kept_open(self) -> AbstractContextManager[None]:
        return nullcontext()

    async def readings(self) -> AsyncGenerator[list[Reading], None]:
        await asyncio.Event().wait()
        yield []


class Beam(Nothing):
    """A source of two readings at a time, with the counts that `counts` gives for the number of a reading, from 0."""

    def __init__(self, counts: Callable[[int], Sequence[float | None]]) -> None:
        super().__init__()
        self.given = 0
        self._counts = counts

    async def readings(self) -> AsyncGenerator[list[Reading], None]:
        while True:
            pair = range(self.given, self.given + 2)
            self.given += 2
            yield [Reading(50.0 + at / RATE_HZ, tuple(self._counts(at))) for at in pair]
            await asyncio.sleep(0)


class Gone(Beam):
    """A device that is not there."""

    def __init__(self) -> None:
        super().__init__(lambda _: ())

    async def readings(self) -> AsyncGenerator[list[Reading], None]:
        raise SourceError("it is gone")
        yield []


class Bench:
    """An acquisition that is given readings."""

    def __init__(self, surface: Surface | None = None, *, rests: bool = False, batch_s: float = 0.004) -> None:
        self.surface = surface or surface_of()
        self.source = Nothing()
        self.logs = SurfaceLogs("bench")
        self.boot = self.logs.begin(boot(), 1000)
        self.pipeline = Pipeline(self.surface, rest=rest_of(self.surface) if rests else None)
        self.line = Acquisition("bench", self.surface, self.source, self.pipeline, self.boot, batch_s, 0.1)

    def take(self, *readings: Reading) -> None:
        self.line._take(list(readings))

    def samples(self) -> list[int]:
        """Return the numbers of all samples in the log."""
        return [one.sample.sequence for one in self.boot.log.from_memory(range(1, self.boot.log.next))]


def reading(at_s: float, *counts: float | None, lost: int = 0, failed: int = 0) -> Reading:
    return Reading(at_s, counts or (REST, REST + 300), lost, failed)
