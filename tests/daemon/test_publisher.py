"""Delivery to a real HTTP server that is there, away, failing, or not on our side."""

import asyncio
import contextlib
import threading
from pathlib import Path
from time import clock_gettime, monotonic, sleep

import pytest

from beamtouch_daemon.delivery.spool import Spool
from beamtouch_daemon.processing.pipeline import Taken
from beamtouch_service.samples import Batch

from .publishing import SENDER, Bench, put, sequences, taken, until
from .service import Service, serving

pytestmark = pytest.mark.anyio


async def test_samples_arrive_once_and_in_order_with_their_age_at_sending() -> None:
    async with serving(Service()) as service, Bench(service) as bench:
        bench.outbox.put(taken(0, 5, age_s=0.4))
        await bench.finish()
    ((surface, batch, _),) = service.batches
    assert (surface, batch.boot_id, batch.channels) == ("bench", "boot-0001", ["s1", "s2"])
    assert [sample.sequence for sample in batch.samples] == [0, 1, 2, 3, 4]
    assert batch.samples[0].deflection_mm == [0.1, None]
    assert 400 <= batch.newest_age_ms < 1000
    assert bench.publisher.published == 5


class Interrupting(Taken):
    """A sample at which the sender is interrupted, as by other programs."""

    @property
    def monotonic_s(self) -> float:
        sleep(0.2)
        return self.reading.monotonic_s


async def test_a_sender_that_is_interrupted_makes_no_sample_younger() -> None:
    (one,) = taken(0, 1)
    async with serving(Service()) as service, Bench(service) as bench:
        bench.outbox.put([Interrupting(one.reading, one.sample)])
        await bench.finish()
    ((_, batch, _),) = service.batches
    assert batch.sent_us is not None
    assert batch.sent_us / 1e6 - batch.newest_age_ms / 1e3 <= one.reading.monotonic_s + 0.001


async def test_a_sample_from_before_a_suspend_is_old(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    slept_s = 3600.0
    with Spool(tmp_path / "spool", 10**6) as spool:
        put(spool, 100, 1)
        waiting = taken(0, 1)
        monkeypatch.setattr("beamtouch_daemon.uptime.clock_gettime", lambda clock: clock_gettime(clock) + slept_s)
        async with serving(Service()) as service, Bench(service, spool=spool) as bench:
            bench.outbox.put(waiting)
            await service.until(2)
    assert [batch.samples[0].sequence for _, batch, _ in service.batches] == [0, 100]
    assert all(slept_s <= batch.newest_age_ms / 1e3 < slept_s + 100 for _, batch, _ in service.batches)


async def test_samples_are_collected_for_batch_ms() -> None:
    begin_s = monotonic()
    async with serving(Service()) as service, Bench(service, batch_s=0.1) as bench:
        for number in range(50):
            bench.outbox.put(taken(number, 1))
            await asyncio.sleep(0.01)
        await bench.finish()
    assert sequences(service) == list(range(50))
    assert 4 <= len(service.batches) <= (monotonic() - begin_s) / 0.1 + 2


@pytest.mark.parametrize("status", [500, 503, 401, 302])
async def test_samples_that_the_service_refuses_now_are_sent_again_with_their_new_age(status: int) -> None:
    service = Service()
    service.statuses = [status, status]
    async with serving(service), Bench(service) as bench:
        bench.outbox.put(taken(0, 3))
        await service.until(3)
    assert sequences(service) == [0, 1, 2]
    assert service.attempts == 3
    assert service.batches[0][1].newest_age_ms >= 300  # 0.1 s and 0.2 s of waiting
    assert bench.outbox.dropped == 0


async def test_a_disk_that_hangs_does_not_hold_up_the_present(tmp_path: Path) -> None:
    with Spool(tmp_path / "spool", 10**6) as spool:
        put(spool, 100, 10)
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


async def test_a_batch_larger_than_the_spool_is_split_and_drops_nothing_else(tmp_path: Path) -> None:
    with Spool(tmp_path / "spool", 10_000) as spool:
        service = Service()
        service.problem_of = lambda *_: (503, "busy")
        async with serving(service), Bench(service, spool=spool) as bench:
            bench.outbox.put(taken(0, 200))
            await until(lambda: bench.publisher.spooled + spool.dropped["bench"] == 200)
            assert bench.publisher.spooled > 0
            assert len(bench.outbox) == bench.outbox.dropped == 0
        while (one := spool.oldest("bench")) is not None:
            newest = one.batch.samples[-1].sequence
            spool.remove("bench", one)
    assert newest == 199


async def test_a_stop_with_a_service_that_hangs_keeps_the_samples_on_disk(tmp_path: Path) -> None:
    with Spool(tmp_path / "spool", 10**6) as spool:
        service = Service()  # it listens, and never answers
        with contextlib.closing(service.listener):
            async with Bench(service, spool=spool) as bench:
                bench.outbox.put(taken(0, 50))
                await asyncio.sleep(0.1)
                await bench.finish()
                assert bench.publisher.spooled == 50


async def test_a_wrong_token_delivers_nothing_and_loses_nothing(caplog: pytest.LogCaptureFixture) -> None:
    async with serving(Service()) as service, Bench(service, token="wrong") as bench:  # noqa: S106
        bench.outbox.put(taken(0, 3))
        await until(lambda: service.attempts >= 2)
    assert len(bench.outbox) == 3
    assert service.batches == []
    complaints = [record.getMessage() for record in caplog.records if "wrong token" in record.getMessage()]
    assert len(complaints) == 1


async def test_a_service_that_is_away_gets_everything_when_it_comes() -> None:
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


async def test_a_full_queue_drops_the_oldest_and_counts_them(caplog: pytest.LogCaptureFixture) -> None:
    service = Service()
    service.statuses = [503]
    async with serving(service), Bench(service, max_samples=100) as bench:
        bench.outbox.put(taken(0, 80))
        await asyncio.sleep(0.05)
        bench.outbox.put(taken(80, 80))
        await bench.finish()
    assert sequences(service) == list(range(60, 160))
    assert bench.outbox.dropped == 60
    assert bench.publisher.published == 100
    assert "bench: 60 samples dropped" in caplog.text


async def test_a_backlog_goes_out_in_batches_of_bounded_size_without_pause() -> None:
    async with serving(Service()) as service, Bench(service, batch_s=60.0) as bench:
        bench.outbox.put(taken(0, 3500))
        await service.until(3000)
    assert max(len(batch.samples) for _, batch, _ in service.batches) == 1000


async def test_samples_of_a_boot_that_had_no_time_are_delivered_after_the_next(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with Spool(tmp_path / "spool", 10**6) as spool:
        samples = [one.sample for one in taken(0, 5)]  # in 1970
        spool.put("bench", Batch(boot_id="boot-0000", channels=SENDER.channels, newest_age_ms=0, samples=samples), 5.0)
    (tmp_path / "another_boot").write_text("another\n")
    monkeypatch.setattr("beamtouch_daemon.delivery.spool.BOOT_ID", tmp_path / "another_boot")
    service = Service()
    with Spool(tmp_path / "spool", 10**6) as spool:
        async with serving(service), Bench(service, spool=spool):
            await service.until(5)
        assert spool.set_aside["bench"] == 0
    assert sequences(service) == [0, 1, 2, 3, 4]


async def test_refused_spooled_samples_do_not_delay_new_ones(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    refused: list[int] = []

    def is_late(batch: Batch) -> bool:
        if batch.boot_id == SENDER.boot_id:
            return False
        refused.append(batch.samples[0].sequence)
        return True

    with Spool(tmp_path / "spool", 10**6) as spool:
        for first in (0, 5, 10):
            samples = [one.sample for one in taken(first, 5)]
            batch = Batch(boot_id="boot-0000", channels=SENDER.channels, newest_age_ms=0, samples=samples)
            spool.put("bench", batch, monotonic() - 60)
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
    refusal = "the service takes no samples (status 503: Busy; send the batch again.); trying again"
    said = [
        record.getMessage() for record in caplog.records if record.name == "beamtouch_daemon.delivery.late_delivery"
    ]
    assert said == [f"bench: publishing spooled samples: {refusal}"]
