"""A log with its two readers, and samples for it."""

import asyncio
import threading
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from time import sleep

from beamtouch_common.uptime import uptime_s
from beamtouch_daemon.delivery.backlog import Backlog
from beamtouch_daemon.delivery.client import ServiceClient
from beamtouch_daemon.delivery.live import Live
from beamtouch_daemon.delivery.log_store import LogStore
from beamtouch_daemon.processing.pipeline import TimedSample
from beamtouch_daemon.sources.reading import Reading
from beamtouch_daemon.tasks import cancel
from beamtouch_service.samples import Batch, Note, Quality, Sample

from .service import TOKEN, Service

CHANNELS = ["s1", "s2"]
ROOM = 10_000_000


def boot(boot_id: str = "boot-0001", channels: list[str] = CHANNELS) -> Batch:
    """Return what all batches of a boot state."""
    return Batch(boot_id=boot_id, channels=channels, samples=[])


def taken(first: int, number: int, age_s: float = 0.0, notes: tuple[Note, ...] = ()) -> list[TimedSample]:
    """Return samples with these numbers, all of the same age."""
    good = [Quality.GOOD, Quality.MISSING]
    return [
        taken_of(
            Sample(sequence=sequence, acquired_unix_us=sequence, deflection_mm=[0.1, None], quality=good), age_s, notes
        )
        for sequence in range(first, first + number)
    ]


def taken_of(sample: Sample, age_s: float = 0.0, notes: tuple[Note, ...] = ()) -> TimedSample:
    """Return a sample of this age."""
    return TimedSample(Reading(uptime_s() - age_s, (None, None)), sample, notes)


class Interrupting(TimedSample):
    """A sample at which the sender is interrupted, as by other programs."""

    @property
    def monotonic_s(self) -> float:
        sleep(0.2)
        return self.reading.monotonic_s


async def hang(store: LogStore, hangs: threading.Event) -> None:
    """Hold up the disk of a log until an event is set."""
    await store._call(lambda _: hangs.wait(60))


class Bench:
    """A log of the surface `bench`, and what delivers it."""

    def __init__(
        self,
        service: Service,
        store: LogStore | None = None,
        *,
        max_samples: int = 10_000,
        token: str = TOKEN,
        head: Batch | None = None,
        url: str = "",
    ) -> None:
        self.store = store or LogStore(None, 0)
        self._client = ServiceClient(url or service.url, token)
        self.logs = self.store.surface("bench")
        self.boot = self.logs.begin(head or boot(), max_samples)
        self.log = self.boot.log
        self.live = Live(self._client, self.logs, self.boot)
        self.backlog = Backlog(self._client, self.store, self.logs, asyncio.Lock())

    async def __aenter__(self) -> "Bench":
        self._tasks = [asyncio.ensure_future(run()) for run in (self.live.run, self.backlog.run, self.store.run)]
        return self

    async def __aexit__(self, *_: object) -> None:
        ends = [task.exception() for task in self._tasks if task.done()]
        await cancel(self._tasks)
        await self._client.__aexit__()
        assert ends == []

    def put(self, samples: list[TimedSample]) -> None:
        """Add samples, and wake the live reader."""
        self.boot.put(samples)
        self.boot.wake_live()

    def count(self, number: int, age_s: float = 0.0) -> None:
        """Add as many samples with the next numbers."""
        self.put(taken(self.log.next, number, age_s))


async def put_chunks(store: LogStore, head: Batch, *numbers: int) -> None:
    """Write a chunk of each of these numbers of samples, from a boot whose batches begin with `head`."""
    log = store.surface("bench").begin(head, sum(numbers)).log
    for number in numbers:
        log.put(taken(log.next, number))
        await store.write(None)


@asynccontextmanager
async def stored(path: Path, max_bytes: int = ROOM) -> AsyncIterator[LogStore]:
    """Open a log file, as a start of the daemon does; close it as a stop does, with all that is left."""
    store = LogStore(path, max_bytes)
    await store.open()
    try:
        yield store
    finally:
        await store.write(None)
        await store.close()


async def keep(path: Path, *numbers: int, boot_id: str = "boot-0000", channels: list[str] = CHANNELS) -> None:
    """Leave samples of an earlier boot in the file: as many in each chunk."""
    async with stored(path) as store:
        await put_chunks(store, boot(boot_id, channels), *numbers)
