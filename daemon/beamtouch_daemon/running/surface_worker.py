"""The worker of one surface: its acquisition and the live reader of its log."""

import uuid
from collections.abc import Awaitable, Callable

from beamtouch_daemon.config.publish import Publish
from beamtouch_daemon.config.settings import Surface
from beamtouch_daemon.delivery.client import ServiceClient
from beamtouch_daemon.delivery.live import Live
from beamtouch_daemon.delivery.log import Sender
from beamtouch_daemon.delivery.log_store import LogStore
from beamtouch_daemon.processing.characteristic import Characteristic
from beamtouch_daemon.processing.pipeline import Pipeline
from beamtouch_daemon.running.acquisition import Acquisition
from beamtouch_daemon.sources.configured import Buses, source_of

PATIENCE_S = 15.0
PATIENCE_PERIODS = 20.0
"""A worker without progress for the longer of this time and this number of reading periods hangs."""


class SurfaceWorker:
    """Reads one surface and publishes its samples."""

    def __init__(
        self,
        name: str,
        surface: Surface,
        rest_gap_mm: dict[str, float],
        publish: Publish,
        client: ServiceClient,
        store: LogStore,
        buses: Buses,
    ) -> None:
        self.name = name
        self.surface = surface
        noise_mm = None if surface.noise_mm is None else [surface.noise_mm] * len(surface.channels)
        characteristic = Characteristic.of(surface.channels, rest_gap_mm).identity
        sender = Sender(str(uuid.uuid4()), surface.channel_names, noise_mm, characteristic, surface.beam)
        logs = store.surface(name)
        log = logs.begin(sender, publish.log_samples)
        source, pipeline = source_of(surface, name, buses), Pipeline(surface, rest_gap_mm)
        self.acquisition = Acquisition(name, surface, source, pipeline, log, publish.batch_ms / 1e3)
        live = Live(client, name, logs, log)
        self.jobs: list[Callable[[], Awaitable[None]]] = [self.acquisition.read, self.acquisition.run, live.run]

    def hangs(self, now_s: float) -> bool:
        """Return whether the source hangs at `now_s` on the monotonic clock: no reading comes, and no error either."""
        return now_s - self.acquisition.turned_s > PATIENCE_S + PATIENCE_PERIODS / self.surface.rate_hz
