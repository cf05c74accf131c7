"""Delivery to a real HTTP server that is there, away, failing, or not on our side."""

import asyncio
import contextlib
import threading
from collections.abc import Callable, Coroutine
from pathlib import Path
from time import monotonic
from typing import Any

import pytest

from beamtouch_daemon.delivery.client import ServiceClient
from beamtouch_daemon.delivery.outbox import Outbox
from beamtouch_daemon.delivery.publisher import Publisher, Sender
from beamtouch_daemon.delivery.spool import Spool
from beamtouch_daemon.delivery.spooler import Disk
from beamtouch_daemon.processing.pipeline import Taken
from beamtouch_daemon.sources.reading import Reading
from beamtouch_service.samples import Batch, Quality, Sample

from .service import TOKEN, Service, serving

SENDER = Sender("bench", ["s1", "s2"], "boot-0001")


def taken(first: int, number: int, age_s: float = 0.0) -> list[Taken]:
    """Return samples with these numbers, all of the same age."""
    good = [Quality.GOOD, Quality.MISSING]
    return [
        Taken(
            Reading(monotonic() - age_s, (None, None)),
            Sample(sequence=sequence, acquired_unix_us=sequence, deflection_mm=[0.1, None], quality=good),
        )
        for sequence in range(first, first + number)
    ]


class Bench:
    """A publisher at work on an outbox."""

    def __init__(
        self,
        service: Service,
        most: int = 10_000,
        batch_s: float = 0.02,
        token: str = TOKEN,
        spool: Spool | None = None,
    ) -> None:
        self.outbox = Outbox(most, "bench")
        self._client = ServiceClient(service.url, token)
        self.disk = Disk(spool) if spool else None
        self.publisher = Publisher(self._client, SENDER, self.outbox, batch_s, self.disk)

    async def __aenter__(self) -> "Bench":
        self._task = asyncio.create_task(self.publisher.run())
        self._helpers = [asyncio.ensure_future(helper()) for helper in self.publisher.helpers]
        return self

    async def __aexit__(self, *_: object) -> None:
        for task in (self._task, *self._helpers):
            task.cancel()
        await asyncio.gather(self._task, *self._helpers, return_exceptions=True)
        await self._client.close()
        if self.disk:
            self.disk.close()

    async def finish(self) -> None:
        """Close the outbox and wait for the delivery of what is in it."""
        self.outbox.close()
        await asyncio.wait_for(self._task, 5)


def run(story: Coroutine[Any, Any, None]) -> None:
    asyncio.run(asyncio.wait_for(story, 15))


async def until(holds: Callable[[], bool]) -> None:
    async with asyncio.timeout(10):
        while not holds():  # noqa: ASYNC110 - what it asks for is elsewhere
            await asyncio.sleep(0.01)


def put(spool: Spool, first: int, number: int, channels: list[str] = SENDER.channels) -> None:
    """Put samples of an earlier sender on the disk, a minute old."""
    samples = [one.sample for one in taken(first, number)]
    batch = Batch(boot_id="boot-0000", channels=channels, newest_age_ms=0, samples=samples)
    spool.put("bench", batch, monotonic() - 60)


def sequences(service: Service) -> list[int]:
    return [sample.sequence for sample in service.samples()]


def test_samples_arrive_once_and_in_order_with_their_age_at_sending() -> None:
    async def story() -> None:
        async with serving(Service()) as service, Bench(service) as bench:
            bench.outbox.put(taken(0, 5, age_s=0.4))
            await bench.finish()
        ((surface, batch, _),) = service.batches
        assert (surface, batch.boot_id, batch.channels) == ("bench", "boot-0001", ["s1", "s2"])
        assert [sample.sequence for sample in batch.samples] == [0, 1, 2, 3, 4]
        assert batch.samples[0].deflection_mm == [0.1, None]
        assert 400 <= batch.newest_age_ms < 1000
        assert bench.publisher.published == 5

    run(story())


def test_samples_are_collected_for_the_length_of_a_batch() -> None:
    async def story() -> None:
        async with serving(Service()) as service, Bench(service, batch_s=0.1) as bench:
            for number in range(50):
                bench.outbox.put(taken(number, 1))
                await asyncio.sleep(0.01)
            await bench.finish()
        assert sequences(service) == list(range(50))
        assert 4 <= len(service.batches) <= 8  # half a second and more, a tenth each

    run(story())


@pytest.mark.parametrize("status", [500, 503, 401, 302])
def test_what_the_service_does_not_take_now_is_sent_again_with_its_new_age(status: int) -> None:
    async def story() -> None:
        service = Service()
        service.statuses = [status, status]
        async with serving(service), Bench(service) as bench:
            bench.outbox.put(taken(0, 3))
            await service.until(3)
        assert sequences(service) == [0, 1, 2]
        assert service.attempts == 3
        assert service.batches[0][1].newest_age_ms >= 300  # 0.1 s and 0.2 s of waiting
        assert bench.outbox.dropped == 0

    run(story())


def test_a_disk_that_hangs_does_not_hold_up_the_present(tmp_path: Path) -> None:
    async def story(spool: Spool) -> None:
        service, hangs = Service(), threading.Event()
        async with serving(service), Bench(service, spool=spool) as bench:
            assert bench.disk is not None
            stuck = asyncio.ensure_future(bench.disk.call(lambda: hangs.wait(60)))
            try:
                service.statuses = [503]
                for number in range(30):
                    bench.outbox.put(taken(number, 1))
                    await asyncio.sleep(0.02)
                await service.until(25)  # of the others, the disk has hold
                assert bench.publisher.spooled == 10
            finally:
                hangs.set()
                await stuck
            await service.until(40)
            assert bench.outbox.dropped == 0

    with Spool(tmp_path / "spool", 10**6) as spool:
        put(spool, 100, 10)
        run(story(spool))


def test_a_batch_larger_than_the_spool_is_split_and_drops_nothing_else(tmp_path: Path) -> None:
    async def story(spool: Spool) -> None:
        service = Service()
        service.problem_of = lambda *_: (503, "busy")
        async with serving(service), Bench(service, spool=spool) as bench:
            bench.outbox.put(taken(0, 200))
            await until(lambda: bench.publisher.spooled + spool.dropped["bench"] == 200)
            assert bench.publisher.spooled > 0
            assert len(bench.outbox) == bench.outbox.dropped == 0

    with Spool(tmp_path / "spool", 10_000) as spool:
        run(story(spool))
        while (one := spool.oldest("bench")) is not None:
            newest = one.batch.samples[-1].sequence
            spool.remove("bench", one)
    assert newest == 199


def test_a_stop_with_a_service_that_hangs_keeps_the_samples_on_disk(tmp_path: Path) -> None:
    async def story(spool: Spool) -> None:
        service = Service()  # it listens, and never answers
        with contextlib.closing(service.listener):
            async with Bench(service, spool=spool) as bench:
                bench.outbox.put(taken(0, 50))
                await asyncio.sleep(0.1)
                await bench.finish()
                assert bench.publisher.spooled == 50

    with Spool(tmp_path / "spool", 10**6) as spool:
        run(story(spool))


def test_a_wrong_token_delivers_nothing_and_loses_nothing(caplog: pytest.LogCaptureFixture) -> None:
    async def story() -> None:
        async with serving(Service()) as service, Bench(service, token="wrong") as bench:  # noqa: S106
            bench.outbox.put(taken(0, 3))
            await asyncio.sleep(0.5)
            assert service.attempts >= 2
        assert len(bench.outbox) == 3
        assert service.batches == []

    run(story())
    complaints = [record.getMessage() for record in caplog.records if "wrong token" in record.getMessage()]
    assert len(complaints) == 1


def test_a_service_that_is_away_gets_everything_when_it_comes() -> None:
    async def story() -> None:
        service = Service()
        address = service.listener.getsockname()
        service.listener.close()
        async with Bench(service) as bench:
            for number in range(40):
                bench.outbox.put(taken(number, 1))
                await asyncio.sleep(0.01)
            assert bench.publisher.published == 0
            late = Service(address)
            async with serving(late):
                await late.until(40)
        assert sequences(late) == list(range(40))
        assert bench.outbox.dropped == 0

    run(story())


def test_a_full_queue_drops_the_oldest_and_counts_them(caplog: pytest.LogCaptureFixture) -> None:
    async def story() -> None:
        service = Service()
        service.statuses = [503]
        async with serving(service), Bench(service, most=100) as bench:
            bench.outbox.put(taken(0, 80))
            await asyncio.sleep(0.05)
            bench.outbox.put(taken(80, 80))
            await bench.finish()
        assert sequences(service) == list(range(60, 160))
        assert bench.outbox.dropped == 60
        assert bench.publisher.published == 100

    run(story())
    assert "bench: 60 samples dropped" in caplog.text


def test_a_backlog_goes_out_in_batches_of_bounded_size_without_pause() -> None:
    async def story() -> None:
        async with serving(Service()) as service, Bench(service, batch_s=1.0) as bench:
            bench.outbox.put(taken(0, 3500))
            await service.until(3000, within_s=3)
        assert max(len(batch.samples) for _, batch, _ in service.batches) == 1000

    run(story())


def test_what_waits_on_the_disk_does_not_hold_up_the_present_while_it_is_refused(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    refused: list[int] = []

    def is_late(batch: Batch) -> bool:
        if batch.boot_id == SENDER.boot_id:
            return False
        refused.append(batch.samples[0].sequence)
        return True

    async def story(spool: Spool) -> None:
        service = Service()
        service.is_busy_for = is_late
        async with serving(service), Bench(service, spool=spool) as bench:
            for number in range(40):
                bench.outbox.put(taken(number, 1))
                await service.until(number + 1)
            assert sequences(service) == list(range(40))
            assert bench.publisher.spooled == 15
            # Not with each live batch, but again and again.
            assert 1 <= len(refused) < 20
            service.is_busy_for = lambda _: False
            await service.until(55)
        assert sequences(service)[-15:] == list(range(15))
        assert bench.outbox.dropped == 0

    with Spool(tmp_path / "spool", 10**6) as spool:
        for first in (0, 5, 10):
            samples = [one.sample for one in taken(first, 5)]
            batch = Batch(boot_id="boot-0000", channels=SENDER.channels, newest_age_ms=0, samples=samples)
            spool.put("bench", batch, monotonic() - 60)
        run(story(spool))
    refusal = "the service takes no samples (status 503: Busy; send the batch again.); trying again"
    said = [
        record.getMessage() for record in caplog.records if record.name == "beamtouch_daemon.delivery.late_delivery"
    ]
    assert said == [f"bench: publishing what waits on the disk: {refusal}"]
