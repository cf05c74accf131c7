"""The daemon at work: every surface reads and publishes on its own, and none can stop another."""

import asyncio
import logging
import signal
import time
import uuid
from collections.abc import Awaitable, Callable
from contextlib import aclosing
from dataclasses import dataclass
from typing import Any

import httpx2
from pymodbus.exceptions import ModbusException

from beamtouch_daemon import tare
from beamtouch_daemon.config import Config, Surface
from beamtouch_daemon.faults import BACKOFF_MAX_S, Backoff, Fault, Tally
from beamtouch_daemon.pipeline import Pipeline
from beamtouch_daemon.publisher import Outbox, Publisher, Sender, make_client
from beamtouch_daemon.sources import source_of
from beamtouch_daemon.sources.reading import Reading, Source, SourceError

DRAIN_S = 2.0
"""How long a stop may take to publish what was taken."""

CANCEL_AGAIN_S = 0.1

_log = logging.getLogger(__name__)


@dataclass(slots=True)
class Summary:
    """What became of one surface's readings."""

    readings: int = 0
    """Taken."""
    readings_lost: int = 0
    """Due but not taken: missed slots, gaps in the device's sequence, and the time without a connection."""
    samples_published: int = 0
    """Acknowledged by the service."""
    samples_dropped: int = 0
    """Taken, but pushed out of the full queue, refused for good, or left over at the end."""


class Acquisition:
    """Readings of one surface into its outbox, across any number of sessions."""

    def __init__(self, name: str, surface: Surface, rest_gap_mm: dict[str, float], outbox: Outbox) -> None:
        self.readings = 0
        self.lost = 0
        self._name = name
        self._rate_hz = surface.rate_hz
        self._source: Source = source_of(surface)
        self._outbox = outbox
        self._pipeline = Pipeline(surface, rest_gap_mm)
        self._backoff = Backoff()
        self._fault = Fault(_log, name)
        self._tally = Tally(_log, f"{name}: %d readings lost")
        self._last_s: float | None = None

    async def run(self) -> None:
        """Read for ever; whatever a session dies of, the next one is tried after a while."""
        while True:
            try:
                await self._session()
            except SourceError as error:
                self._fault.failed(f"{error}; trying again")
            await asyncio.sleep(self._backoff.next())

    async def _session(self) -> None:
        self._pipeline.restart()
        is_first = True
        async with aclosing(self._source.readings()) as stream:
            async for readings in stream:
                if is_first:
                    self._resume(readings[0])
                    is_first = False
                self._take(readings)

    def _resume(self, reading: Reading) -> None:
        """Count what was missed between the sessions, by the clock."""
        if self._last_s is None:
            _log.info("%s: reading", self._name)
        else:
            self._count_lost(max(0, round((reading.monotonic_s - self._last_s) * self._rate_hz) - 1))
        self._fault.recovered()
        self._backoff.reset()

    def _take(self, readings: list[Reading]) -> None:
        self.readings += len(readings)
        self._count_lost(sum(reading.lost for reading in readings))
        self._last_s = readings[-1].monotonic_s
        self._outbox.put(self._pipeline.process(readings, time.time() - time.monotonic()))

    def _count_lost(self, number: int) -> None:
        self.lost += number
        self._tally.add(number)


class Line:
    """One surface from its source to the service."""

    def __init__(
        self, name: str, config: Config, rest_gap_mm: dict[str, float], client: httpx2.AsyncClient, boot_id: str
    ) -> None:
        self.name = name
        surface = config.surfaces[name]
        self.outbox = Outbox(config.publish.queue_samples, name)
        self.acquisition = Acquisition(name, surface, rest_gap_mm, self.outbox)
        sender = Sender(name, surface.channel_names, boot_id)
        self.publisher = Publisher(client, sender, self.outbox, config.publish.batch_ms / 1e3)

    def summary(self) -> Summary:
        """Return the counts so far; what waits in the outbox counts as dropped."""
        return Summary(
            self.acquisition.readings,
            self.acquisition.lost,
            self.publisher.published,
            self.outbox.dropped + len(self.outbox),
        )


async def run(config: Config, token: str) -> dict[str, Summary]:
    """Read and publish all surfaces until SIGTERM or SIGINT; return what became of their readings, by name.

    Raises ConfigError if a tare file does not fit.
    """
    stop = asyncio.Event()
    loop = asyncio.get_running_loop()
    loop.set_exception_handler(_on_loop_error)
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, stop.set)
    rest = {name: tare.load(config.tare_file(name), s.channel_names) for name, s in config.surfaces.items()}
    boot_id = str(uuid.uuid4())
    async with make_client(config.publish.url, token) as client:
        lines = [Line(name, config, rest[name], client, boot_id) for name in config.surfaces]
        await _work(lines, stop)
    return {line.name: line.summary() for line in lines}


async def _work(lines: list[Line], stop: asyncio.Event) -> None:
    """Keep all lines going until `stop`, then let them deliver what they have, for `DRAIN_S` at most."""
    async with asyncio.TaskGroup() as group:
        acquisitions = [group.create_task(_keep_going(line.name, line.acquisition.run)) for line in lines]
        deliveries = [group.create_task(_keep_going(line.name, line.publisher.run)) for line in lines]
        await stop.wait()
        await cancel(set(acquisitions))
        for line in lines:
            line.outbox.close()
        _, unfinished = await asyncio.wait(deliveries, timeout=DRAIN_S)
        await cancel(unfinished)


async def cancel(tasks: set[asyncio.Task[None]]) -> None:
    """Cancel tasks until they are done: before Python 3.12, `wait_for` swallows a cancellation at the wrong moment."""
    while tasks:
        for task in tasks:
            task.cancel()
        _, tasks = await asyncio.wait(tasks, timeout=CANCEL_AGAIN_S)


async def _keep_going(name: str, work: Callable[[], Awaitable[None]]) -> None:
    """Run `work` to its end; an error that nobody foresaw ends here, in the log, and `work` begins again."""
    while True:
        try:
            await work()
        except Exception:  # noqa: BLE001 - logged whole; one surface's fault must not stop the others
            _log.exception("%s: unexpected error; starting anew", name)
            await asyncio.sleep(BACKOFF_MAX_S)
        else:
            return


def _on_loop_error(loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
    """Pass over what pymodbus raises into the loop when a frame cannot be decoded: the request then times out."""
    if isinstance(context.get("exception"), ModbusException):
        _log.debug("undecodable frame: %s", context["exception"])
    else:
        loop.default_exception_handler(context)
