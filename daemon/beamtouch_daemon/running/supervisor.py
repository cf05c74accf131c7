"""All lines of a configuration: started, replaced by those of a new configuration, stopped."""

import asyncio
import logging
from collections.abc import Iterable, Iterator

from beamtouch_daemon.config.settings import Config
from beamtouch_daemon.config.sources import ModbusRtu
from beamtouch_daemon.delivery.client import ServiceClient
from beamtouch_daemon.delivery.late_delivery import LateDelivery
from beamtouch_daemon.delivery.spooler import Disk
from beamtouch_daemon.processing import tare
from beamtouch_daemon.running.surface_worker import Line, Shared, Summary
from beamtouch_daemon.tasks import cancel, keep_going

_log = logging.getLogger(__name__)


class Supervisor:
    """Keeps one line going per surface.

    Parameters
    ----------
    group
        In which the lines' tasks run.
    disk
        The spool, if there is one.
    """

    def __init__(self, group: asyncio.TaskGroup, disk: Disk | None) -> None:
        self._group = group
        self._disk = disk
        self._lines: dict[str, Line] = {}
        self._ended: dict[str, Summary] = {}
        self._shared: Shared | None = None
        self._secrets: tuple[str, str | None] = "", None
        self._leftovers: set[asyncio.Task[None]] = set()
        """Deliver what waits on the disk for surfaces that are not configured any more."""

    @property
    def lines(self) -> Iterable[Line]:
        """Those at work."""
        return self._lines.values()

    async def apply(self, config: Config) -> list[str]:
        """Make the lines those of `config`; return the names of those that were started.

        A line whose surface, rest gaps and publication are as before goes on undisturbed. All that can be wrong with
        the configuration is read before anything changes.

        Raises
        ------
        ConfigError
            The token or a tare file cannot be used; nothing changed.
        """
        secrets = config.read_token(), config.read_certificates()
        rest = {name: tare.load(config.tare_file(name), s.channel_names) for name, s in config.surfaces.items()}
        old = self._shared
        if old is None or old.publish != config.publish or self._secrets != secrets:
            client = ServiceClient(config.publish.url, *secrets)
            shared = Shared(client, config.publish, old.buses if old else {}, self._disk)
        else:
            shared = old
        kept = {
            name
            for name, line in self._lines.items()
            if shared is old and config.surfaces.get(name) == line.surface and rest[name] == line.rest_gap_mm
        }
        await cancel(self._leftovers)
        await asyncio.gather(*(self._end(name) for name in set(self._lines) - kept))
        if old is not None and shared is not old:
            await old.client.close()
        self._shared, self._secrets = shared, secrets
        _forget_buses(shared, config)
        started = [name for name in config.surfaces if name not in kept]
        for name in started:
            self._lines[name] = Line(name, config.surfaces[name], rest[name], shared)
            self._lines[name].start(self._group)
        self._leftovers = set(self._deliver_leftovers(shared))
        return started

    async def stop(self) -> dict[str, Summary]:
        """Stop all lines; return what became of the readings since the start, by surface."""
        await cancel(self._leftovers)
        await asyncio.gather(*(self._end(name) for name in list(self._lines)))
        if self._shared is not None:
            await self._shared.client.close()
        return self._ended

    def spooled_elsewhere(self) -> dict[str, int]:
        """Return the samples on disk of surfaces that are not configured."""
        waiting = dict(self._disk.spool.waiting) if self._disk else {}
        return {name: samples for name, samples in waiting.items() if samples > 0 and name not in self._lines}

    def _deliver_leftovers(self, shared: Shared) -> Iterator[asyncio.Task[None]]:
        for name, samples in self.spooled_elsewhere().items():
            assert shared.disk is not None  # noqa: S101 - narrows the type; without a disk nothing is on it
            _log.info("%s: not configured any more; %d samples on disk are delivered all the same", name, samples)
            late = LateDelivery(shared.client, name, shared.disk, shared.publish.batch_ms / 1e3, lambda: False)
            yield self._group.create_task(keep_going(name, late.run))

    async def _end(self, name: str) -> None:
        line = self._lines[name]
        await line.stop()
        del self._lines[name]
        counts, before = line.summary(), self._ended.get(name, Summary())
        self._ended[name] = Summary(
            before.readings + counts.readings,
            before.readings_lost + counts.readings_lost,
            before.samples_published + counts.samples_published,
            before.samples_dropped + counts.samples_dropped,
            before.samples_set_aside + counts.samples_set_aside,
            counts.samples_spooled,
        )


def _forget_buses(shared: Shared, config: Config) -> None:
    """Forget the buses that are not used as they were. The others know what their units still owe."""
    used = {
        settings.port: settings.line
        for settings in (surface.source for surface in config.surfaces.values())
        if isinstance(settings, ModbusRtu)
    }
    for port in [port for port, bus in shared.buses.items() if used.get(port) != bus.line]:
        del shared.buses[port]
