"""Starts, replaces and stops the workers, following the configuration."""

import asyncio
import logging
from collections.abc import Iterable, Iterator

from beamtouch_daemon.config import tare_file
from beamtouch_daemon.config.settings import Config
from beamtouch_daemon.config.sources import ModbusRtu
from beamtouch_daemon.delivery.client import ServiceClient
from beamtouch_daemon.delivery.late_delivery import LateDelivery
from beamtouch_daemon.delivery.spooler import Disk
from beamtouch_daemon.running.surface_worker import Shared, Summary, SurfaceWorker
from beamtouch_daemon.tasks import cancel, keep_going

_log = logging.getLogger(__name__)


class Supervisor:
    """Keeps one worker running per surface.

    Parameters
    ----------
    group
        Runs the workers' tasks.
    disk
        The spool, if there is one.
    """

    def __init__(self, group: asyncio.TaskGroup, disk: Disk | None) -> None:
        self._group = group
        self._disk = disk
        self._workers: dict[str, SurfaceWorker] = {}
        self._ended: dict[str, Summary] = {}
        self._shared: Shared | None = None
        self._secrets: tuple[str, str | None] = "", None
        self._leftovers: set[asyncio.Task[None]] = set()
        """Tasks that deliver the spooled samples of surfaces that are no longer configured."""
        self._late: list[tuple[str, LateDelivery]] = []
        """All such deliveries since the start, with the names of their surfaces."""

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
            shared = Shared(client, config.publish, old.buses if old else {}, self._disk)
        else:
            shared = old
        kept = {
            name
            for name, worker in self._workers.items()
            if shared is old and config.surfaces.get(name) == worker.surface and rest[name] == worker.rest_gap_mm
        }
        await cancel(self._leftovers)
        await asyncio.gather(*(self._end(name) for name in set(self._workers) - kept))
        if old is not None and shared is not old:
            await old.client.close()
        self._shared, self._secrets = shared, secrets
        _forget_buses(shared, config)
        started = [name for name in config.surfaces if name not in kept]
        for name in started:
            self._workers[name] = SurfaceWorker(name, config.surfaces[name], rest[name], shared)
            self._workers[name].start(self._group)
        self._leftovers = set(self._deliver_leftovers(shared))
        return started

    async def stop(self) -> dict[str, Summary]:
        """Stop all workers; return the counts since the start, by surface."""
        await cancel(self._leftovers)
        await asyncio.gather(*(self._end(name) for name in list(self._workers)))
        if self._shared is not None:
            await self._shared.client.close()
        for name, late in self._late:
            if late.delivered:
                self._ended.setdefault(name, Summary()).samples_published += late.delivered
        for name, summary in self._ended.items():
            summary.samples_spooled = max(0, self._disk.spool.waiting[name]) if self._disk else 0
        return self._ended

    def spooled_elsewhere(self) -> dict[str, int]:
        """Return the spooled samples of surfaces that are not configured, by surface."""
        waiting = dict(self._disk.spool.waiting) if self._disk else {}
        return {name: samples for name, samples in waiting.items() if samples > 0 and name not in self._workers}

    def _deliver_leftovers(self, shared: Shared) -> Iterator[asyncio.Task[None]]:
        if shared.disk is None:
            return
        for name, samples in self.spooled_elsewhere().items():
            _log.info("%s: no longer configured; its %d spooled samples are delivered", name, samples)
            late = LateDelivery(shared.client, name, shared.disk, shared.publish.batch_ms / 1e3, lambda: False)
            self._late.append((name, late))
            yield self._group.create_task(keep_going(name, late.run))

    async def _end(self, name: str) -> None:
        worker = self._workers[name]
        await worker.stop()
        del self._workers[name]
        counts, before = worker.summary(), self._ended.get(name, Summary())
        self._ended[name] = Summary(
            before.readings + counts.readings,
            before.readings_lost + counts.readings_lost,
            before.samples_published + counts.samples_published,
            before.samples_dropped + counts.samples_dropped,
            before.samples_set_aside + counts.samples_set_aside,
            counts.samples_spooled,
        )


def _forget_buses(shared: Shared, config: Config) -> None:
    """Forget buses that are unused or have new settings. The others still know which answers their units owe."""
    used = {
        settings.port: settings.line
        for settings in (surface.source for surface in config.surfaces.values())
        if isinstance(settings, ModbusRtu)
    }
    for port in [port for port, bus in shared.buses.items() if used.get(port) != bus.line]:
        del shared.buses[port]
