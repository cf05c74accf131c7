"""The worker of one surface: reads its source and publishes its samples until it is stopped."""

import asyncio
import uuid
from dataclasses import dataclass

from beamtouch_daemon.config.publish import Publish
from beamtouch_daemon.config.settings import Surface
from beamtouch_daemon.delivery.backlog import Backlog
from beamtouch_daemon.delivery.client import ServiceClient
from beamtouch_daemon.delivery.live import Live
from beamtouch_daemon.delivery.log import Sender
from beamtouch_daemon.delivery.log_store import LogStore
from beamtouch_daemon.processing.characteristic import Characteristic
from beamtouch_daemon.running.acquisition import Acquisition
from beamtouch_daemon.sources.configured import Buses
from beamtouch_daemon.tasks import cancel, keep_going
from beamtouch_daemon.uptime import uptime_s

PATIENCE_S = 15.0
PATIENCE_PERIODS = 20.0
"""A worker without progress for the longer of this time and this number of reading periods hangs."""


@dataclass(frozen=True)
class Shared:
    """Shared by all workers."""

    client: ServiceClient
    publish: Publish
    buses: Buses
    store: LogStore


class SurfaceWorker:
    """Reads and publishes one surface."""

    def __init__(self, name: str, surface: Surface, rest_gap_mm: dict[str, float], shared: Shared) -> None:
        self.name = name
        self.surface = surface
        self.rest_gap_mm = rest_gap_mm
        noise_mm = None if surface.noise_mm is None else [surface.noise_mm] * len(surface.channels)
        characteristic = Characteristic.of(surface.channels, rest_gap_mm).identity
        # A restarted worker numbers its samples from 1 again, so it needs a boot id of its own.
        sender = Sender(str(uuid.uuid4()), surface.channel_names, noise_mm, characteristic, surface.beam)
        self.logs = shared.store.surface(name)
        self.log = self.logs.begin(sender, shared.publish.log_samples)
        self.acquisition = Acquisition(
            name, surface, rest_gap_mm, self.log, shared.buses, shared.publish.batch_ms / 1e3
        )
        self.live = Live(shared.client, name, self.logs, self.log)
        self.backlog = Backlog(shared.client, name, shared.store, self.live)
        self._tasks: list[asyncio.Task[None]] = []

    def start(self, group: asyncio.TaskGroup) -> None:
        """Start to read and to publish."""
        for work in (self.acquisition.read, self.acquisition.process, self.live.run, self.backlog.run):
            self._tasks.append(group.create_task(keep_going(self.name, work)))

    async def stop(self) -> None:
        """Stop reading and publishing; what is left is in the log."""
        await cancel(self._tasks)
        self.acquisition.process_all()

    def hangs(self, now_s: float) -> bool:
        """Return whether reading or publishing hangs at `now_s` on the monotonic clock."""
        patience_s = PATIENCE_S + PATIENCE_PERIODS / self.surface.rate_hz
        publishes = not self.live.waiting or now_s - self.live.turned_s < patience_s
        return not publishes or now_s - self.acquisition.turned_s > patience_s

    def age_s(self) -> float | None:
        """Return the age of the newest reading [s]; None before the first."""
        return None if self.acquisition.last_s is None else uptime_s() - self.acquisition.last_s
