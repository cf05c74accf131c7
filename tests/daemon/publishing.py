"""A publisher with its outbox, and samples for it."""

import asyncio
from collections.abc import Callable

from beamtouch_daemon.delivery.client import ServiceClient
from beamtouch_daemon.delivery.outbox import Outbox
from beamtouch_daemon.delivery.publisher import Publisher, Sender
from beamtouch_daemon.delivery.spool import Spool
from beamtouch_daemon.delivery.spooler import Disk
from beamtouch_daemon.processing.pipeline import Taken
from beamtouch_daemon.sources.reading import Reading
from beamtouch_daemon.uptime import uptime_s
from beamtouch_service.samples import Batch, Quality, Sample

from .service import TOKEN, Service

SENDER = Sender("bench", ["s1", "s2"], "boot-0001")


def taken(first: int, number: int, age_s: float = 0.0) -> list[Taken]:
    """Return samples with these numbers, all of the same age."""
    good = [Quality.GOOD, Quality.MISSING]
    return [
        Taken(
            Reading(uptime_s() - age_s, (None, None)),
            Sample(sequence=sequence, acquired_unix_us=sequence, deflection_mm=[0.1, None], quality=good),
        )
        for sequence in range(first, first + number)
    ]


class Bench:
    """A publisher at work on an outbox."""

    def __init__(
        self,
        service: Service,
        max_samples: int = 10_000,
        batch_s: float = 0.02,
        token: str = TOKEN,
        spool: Spool | None = None,
        sender: Sender = SENDER,
    ) -> None:
        self.outbox = Outbox(max_samples, "bench")
        self._client = ServiceClient(service.url, token)
        self.disk = Disk(spool) if spool else None
        self.publisher = Publisher(self._client, sender, self.outbox, batch_s, self.disk)

    async def __aenter__(self) -> "Bench":
        self._task = asyncio.create_task(self.publisher.run())
        self._helpers = [asyncio.ensure_future(helper()) for helper in self.publisher.helpers]
        return self

    async def __aexit__(self, *_: object) -> None:
        for task in (self._task, *self._helpers):
            task.cancel()
        ends = await asyncio.gather(self._task, *self._helpers, return_exceptions=True)
        await self._client.close()
        if self.disk:
            self.disk.close()
        for end in ends:
            if isinstance(end, Exception):
                raise end

    async def finish(self) -> None:
        """Close the outbox and wait for the delivery of what is in it."""
        self.outbox.close()
        await asyncio.wait_for(self._task, 60)


async def until(holds: Callable[[], bool]) -> None:
    async with asyncio.timeout(60):
        while not holds():  # noqa: ASYNC110 - what it asks for is elsewhere
            await asyncio.sleep(0.01)


def put(spool: Spool, first: int, number: int, channels: list[str] = SENDER.channels) -> None:
    """Put samples of an earlier sender on the disk, a minute old."""
    samples = [one.sample for one in taken(first, number)]
    batch = Batch(boot_id="boot-0000", channels=channels, newest_age_ms=0, samples=samples)
    spool.put("bench", batch, uptime_s() - 60)


def sequences(service: Service) -> list[int]:
    return [sample.sequence for sample in service.samples()]
