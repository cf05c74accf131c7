"""The worker of one surface: reads its source and publishes its samples until it is stopped."""

import asyncio
import logging
import uuid
from dataclasses import dataclass

from beamtouch_daemon.config.publish import Publish
from beamtouch_daemon.config.settings import Surface
from beamtouch_daemon.delivery.client import ServiceClient
from beamtouch_daemon.delivery.outbox import Outbox
from beamtouch_daemon.delivery.publisher import Publisher, Sender
from beamtouch_daemon.delivery.spooler import Disk
from beamtouch_daemon.processing.characteristic import Characteristic
from beamtouch_daemon.running.acquisition import Acquisition
from beamtouch_daemon.sources.configured import Buses
from beamtouch_daemon.tasks import cancel, keep_going
from beamtouch_daemon.uptime import uptime_s

DRAIN_S = 4.0
"""Time limit for a stop to publish or spool the remaining samples."""
PATIENCE_S = 15.0
PATIENCE_PERIODS = 20.0
"""A worker without progress for the longer of this time and this number of reading periods hangs."""

_log = logging.getLogger(__name__)


@dataclass(slots=True)
class Summary:
    """Final counts of one surface."""

    readings: int = 0
    """Taken."""
    readings_lost: int = 0
    """Due but not taken: poll slots, numbers of the device's sequence, and the time without a connection."""
    samples_published: int = 0
    """Acknowledged by the service."""
    samples_dropped: int = 0
    """Discarded for lack of room in memory or in the spool, or neither delivered nor spooled at the end."""
    samples_set_aside: int = 0
    """Refused for good by the service, or damaged on disk; kept in the spool for inspection."""
    samples_spooled: int = 0
    """In the spool, delivered after the next start."""


@dataclass(frozen=True)
class Shared:
    """Shared by all workers."""

    client: ServiceClient
    publish: Publish
    buses: Buses
    disk: Disk | None


class SurfaceWorker:
    """Reads and publishes one surface."""

    def __init__(self, name: str, surface: Surface, rest_gap_mm: dict[str, float], shared: Shared) -> None:
        self.name = name
        self.surface = surface
        self.rest_gap_mm = rest_gap_mm
        self.outbox = Outbox(shared.publish.queue_samples, name)
        self.acquisition = Acquisition(name, surface, rest_gap_mm, self.outbox, shared.buses)
        # A restarted worker numbers its samples from 0 again, so it needs a boot id of its own.
        noise_mm = None if surface.noise_mm is None else [surface.noise_mm] * len(surface.channels)
        characteristic = Characteristic.of(surface.channels, rest_gap_mm).identity
        boot_id = str(uuid.uuid4())
        sender = Sender(name, surface.channel_names, boot_id, noise_mm, characteristic, surface.beam)
        self.publisher = Publisher(shared.client, sender, self.outbox, shared.publish.batch_ms / 1e3, shared.disk)
        self._spool = shared.disk and shared.disk.spool
        # The spool's counts continue when a worker is restarted.
        self._before = (self._spool.dropped[name], self._spool.set_aside[name]) if self._spool else (0, 0)
        self._tasks: list[asyncio.Task[None]] = []

    def start(self, group: asyncio.TaskGroup) -> None:
        """Start to read and to publish."""
        for work in (self.acquisition.run, self.publisher.run, *self.publisher.helpers):
            self._tasks.append(group.create_task(keep_going(self.name, work)))

    async def stop(self) -> None:
        """Stop reading and deliver the remaining samples, for at most `DRAIN_S`."""
        acquisition, publisher, *helpers = self._tasks
        await cancel({acquisition})
        self.outbox.close()
        await asyncio.wait({publisher}, timeout=DRAIN_S)
        await cancel({publisher, *helpers})
        self.publisher.give_up()
        if left := self.outbox.take(len(self.outbox)):
            self.outbox.dropped += len(left)
            _log.warning("%s: %d samples dropped: neither the service nor the spool took them", self.name, len(left))

    def hangs(self, now_s: float) -> bool:
        """Return whether reading or publishing hangs at `now_s` on the monotonic clock."""
        patience_s = PATIENCE_S + PATIENCE_PERIODS / self.surface.rate_hz
        publishes = not len(self.outbox) or now_s - self.publisher.turned_s < patience_s
        return not publishes or now_s - self.acquisition.turned_s > patience_s

    def age_s(self) -> float | None:
        """Return the age of the newest reading [s]; None before the first."""
        return None if self.acquisition.last_s is None else uptime_s() - self.acquisition.last_s

    def summary(self) -> Summary:
        """Return the counts so far."""
        dropped, set_aside = (0, 0)
        if self._spool:
            dropped = self._spool.dropped[self.name] - self._before[0]
            set_aside = self._spool.set_aside[self.name] - self._before[1]
        return Summary(
            self.acquisition.readings,
            self.acquisition.lost,
            self.publisher.published,
            self.outbox.dropped + dropped,
            set_aside,
            self.publisher.spooled,
        )
