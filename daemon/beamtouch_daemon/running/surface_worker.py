"""One surface from its source to the service, as tasks that nothing but a stop ends."""

import asyncio
import logging
import uuid
from dataclasses import dataclass
from time import monotonic

from beamtouch_daemon.config.settings import Publish, Surface
from beamtouch_daemon.delivery.client import ServiceClient
from beamtouch_daemon.delivery.outbox import Outbox
from beamtouch_daemon.delivery.publisher import Publisher, Sender
from beamtouch_daemon.delivery.spooler import Disk
from beamtouch_daemon.running.acquisition import Acquisition
from beamtouch_daemon.sources import Buses
from beamtouch_daemon.tasks import cancel, keep_going

DRAIN_S = 4.0
"""How long a stop may take to publish what was taken, or to put it on the disk."""
PATIENCE_S = 15.0
PATIENCE_PERIODS = 20.0
"""Without progress for so long, the longer of a time and a number of reading periods, a line hangs."""

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
    """Taken, but pushed out of a full queue or spool, or neither delivered nor on disk at the end."""
    samples_set_aside: int = 0
    """Refused for good or damaged on disk, and kept there for a person to look at."""
    samples_spooled: int = 0
    """On disk, to be delivered after the next start."""


@dataclass(frozen=True)
class Shared:
    """What all lines have in common."""

    client: ServiceClient
    publish: Publish
    buses: Buses
    disk: Disk | None


class Line:
    """One surface at work."""

    def __init__(self, name: str, surface: Surface, rest_gap_mm: dict[str, float], shared: Shared) -> None:
        self.name = name
        self.surface = surface
        self.rest_gap_mm = rest_gap_mm
        self.outbox = Outbox(shared.publish.queue_samples, name)
        self.acquisition = Acquisition(name, surface, rest_gap_mm, self.outbox, shared.buses)
        # A line that is started anew counts its samples anew, so it is another sender.
        sender = Sender(name, surface.channel_names, str(uuid.uuid4()))
        self.publisher = Publisher(shared.client, sender, self.outbox, shared.publish.batch_ms / 1e3, shared.disk)
        self._spool = shared.disk and shared.disk.spool
        # The spool goes on counting when a line is started anew.
        self._before = (self._spool.dropped[name], self._spool.set_aside[name]) if self._spool else (0, 0)
        self._tasks: list[asyncio.Task[None]] = []

    def start(self, group: asyncio.TaskGroup) -> None:
        """Begin to read and to publish."""
        for work in (self.acquisition.run, self.publisher.run, *self.publisher.helpers):
            self._tasks.append(group.create_task(keep_going(self.name, work)))

    async def stop(self) -> None:
        """Stop reading and deliver what was taken, for `DRAIN_S` at most."""
        acquisition, publisher, *helpers = self._tasks
        await cancel({acquisition})
        self.outbox.close()
        await asyncio.wait({publisher}, timeout=DRAIN_S)
        await cancel({publisher, *helpers})
        self.publisher.give_up()
        if lost := len(self.outbox):
            _log.warning("%s: %d samples are lost: neither the service nor the disk took them", self.name, lost)

    def hangs(self, now_s: float) -> bool:
        """Whether reading or publishing has made no progress for too long, at `now_s` on the monotonic clock."""
        patience_s = PATIENCE_S + PATIENCE_PERIODS / self.surface.rate_hz
        publishes = not len(self.outbox) or now_s - self.publisher.turned_s < patience_s
        return not publishes or now_s - self.acquisition.turned_s > patience_s

    def age_s(self) -> float | None:
        """How long ago the last reading was taken [s]; None before the first."""
        return None if self.acquisition.last_s is None else monotonic() - self.acquisition.last_s

    def summary(self) -> Summary:
        """Return the counts so far; what waits in memory counts as dropped."""
        dropped, set_aside = (0, 0)
        if self._spool:
            dropped = self._spool.dropped[self.name] - self._before[0]
            set_aside = self._spool.set_aside[self.name] - self._before[1]
        return Summary(
            self.acquisition.readings,
            self.acquisition.lost,
            self.publisher.published,
            self.outbox.dropped + len(self.outbox) + dropped,
            set_aside,
            self.publisher.spooled,
        )
