"""Starts, replaces and stops the workers, following the configuration."""

import asyncio
import logging
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass

from beamtouch_daemon.config import tare_file
from beamtouch_daemon.config.settings import Config
from beamtouch_daemon.config.sources import ModbusRtu
from beamtouch_daemon.delivery.backlog import Backlog
from beamtouch_daemon.delivery.client import ServiceClient
from beamtouch_daemon.delivery.log_store import LogStore
from beamtouch_daemon.running.surface_worker import Shared, SurfaceWorker
from beamtouch_daemon.tasks import cancel, keep_going

FINISH_S = 2.5
"""Time limit for a stop to deliver the remaining samples; the service makes them durable once a second."""
_log = logging.getLogger(__name__)


@dataclass(slots=True)
class Summary:
    """Final counts of one surface."""

    readings: int = 0
    """Taken."""
    readings_lost: int = 0
    """Due but not taken: poll slots, numbers of the device's sequence, and the time without a connection."""
    samples_published: int = 0
    """Durable in the record of the service."""
    samples_dropped: int = 0
    """Discarded for lack of room in memory and in the log file, lost with that file, or refused by the service."""
    samples_in_log: int = 0
    """In the log file, delivered after the next start."""


class Supervisor:
    """Keeps one worker running per surface.

    Parameters
    ----------
    group
        Runs the workers' tasks.
    store
        The logs of all surfaces.
    """

    def __init__(self, group: asyncio.TaskGroup, store: LogStore) -> None:
        self._group = group
        self._store = store
        self._workers: dict[str, SurfaceWorker] = {}
        self._ended: dict[str, Summary] = {}
        """Readings of workers that ended."""
        self._shared: Shared | None = None
        self._secrets: tuple[str, str | None] = "", None
        self._leftovers: list[Backlog] = []
        """Those of surfaces that are no longer configured."""
        self._deliveries: set[asyncio.Task[None]] = set()
        """Their tasks."""

    @property
    def workers(self) -> Iterable[SurfaceWorker]:
        """The workers that run now."""
        return self._workers.values()

    async def apply(self, config: Config) -> list[str]:
        """Replace the workers by those of `config`; return the surfaces whose workers were started.

        A worker continues undisturbed if its surface, its rest gaps and [publish] have not changed. The whole
        configuration is checked before anything changes.

        Raises
        ------
        InputError, FailedError
            The token or a tare file cannot be used, or cannot be read now; nothing changed.
        """
        secrets = config.read_token(), config.read_certificates()
        rest = {name: tare_file.load(config.tare_file(name), s.channel_names) for name, s in config.surfaces.items()}
        old = self._shared
        if old is None or old.publish != config.publish or self._secrets != secrets:
            client = ServiceClient(config.publish.url, *secrets)
            shared = Shared(client, config.publish, old.buses if old else {}, self._store)
        else:
            shared = old
        kept = {
            name
            for name, worker in self._workers.items()
            if shared is old and config.surfaces.get(name) == worker.surface and rest[name] == worker.rest_gap_mm
        }
        await cancel(self._deliveries)
        await asyncio.gather(*(self._end(name) for name in set(self._workers) - kept))
        if old is not None and shared is not old:
            await old.client.close()
        self._shared, self._secrets = shared, secrets
        _forget_buses(shared, config)
        started = [name for name in config.surfaces if name not in kept]
        for name in started:
            self._workers[name] = SurfaceWorker(name, config.surfaces[name], rest[name], shared)
            self._workers[name].start(self._group)
        self._leftovers = list(self._left_over(shared))
        self._deliveries = {self._group.create_task(keep_going("backlog", one.run)) for one in self._leftovers}
        return started

    async def stop(self) -> dict[str, Summary]:
        """Stop all workers, and deliver or write what is left; return the counts since the start, by surface."""
        await cancel(self._deliveries)
        workers = list(self._workers.values())
        await asyncio.gather(*(self._end(worker.name) for worker in workers))
        with suppress(TimeoutError):
            async with asyncio.timeout(FINISH_S):
                backlogs = [*(worker.backlog for worker in workers), *self._leftovers]
                await asyncio.gather(*(backlog.finish() for backlog in backlogs))
        if self._shared is not None:
            await self._shared.client.close()
        await self._store.write(None)
        for name, logs in self._store.surfaces().items():
            if lost := sum(log.give_up() for log in logs.by_boot.values()):
                _log.warning("%s: %d samples dropped: neither the service nor the log file took them", name, lost)
            if logs.counts.published or logs.counts.dropped or logs.on_disk:
                summary = self._ended.setdefault(name, Summary())
                summary.samples_published = logs.counts.published
                summary.samples_dropped = logs.counts.dropped
                summary.samples_in_log = logs.on_disk
        return self._ended

    def _left_over(self, shared: Shared) -> Iterator[Backlog]:
        for name, logs in self._store.surfaces().items():
            if name not in self._workers and logs.by_boot:
                logs.end()
                _log.info("%s: not configured; the samples in its log are delivered", name)
                yield Backlog(shared.client, name, shared.store)

    async def _end(self, name: str) -> None:
        worker = self._workers.pop(name)
        await worker.stop()
        ended = self._ended.setdefault(name, Summary())
        ended.readings += worker.acquisition.readings
        ended.readings_lost += worker.acquisition.lost


def _forget_buses(shared: Shared, config: Config) -> None:
    """Forget buses that are unused or have new settings. The others still know which answers their units owe."""
    used = {
        settings.port: settings.line
        for settings in (surface.source for surface in config.surfaces.values())
        if isinstance(settings, ModbusRtu)
    }
    for port in [port for port, bus in shared.buses.items() if used.get(port) != bus.line]:
        del shared.buses[port]
