"""New samples to a real HTTP server that is there, away, failing, or not on our side."""

import asyncio
import threading
from pathlib import Path
from time import clock_gettime, monotonic, sleep

import pytest

from beamtouch_daemon.delivery.log import MAX_BATCH
from beamtouch_daemon.delivery.log_store import LogStore
from beamtouch_daemon.processing.pipeline import Taken
from beamtouch_service.samples import Note
from free_ports import free_port

from .publishing import Bench, keep, sequences, stored, taken, until
from .record import Record
from .service import Service, serving

pytestmark = pytest.mark.anyio


async def test_samples_arrive_once_and_in_order_with_their_age_and_are_forgotten_when_durable() -> None:
    async with serving(Service()) as service, Bench(service) as bench:
        put_s = [monotonic()]
        bench.count(5, age_s=0.4)
        await service.until(5)
        put_s.append(monotonic())
        bench.count(5)
        await until(lambda: bench.log.is_empty)
    assert sequences(service) == list(range(1, 11))
    assert service.record.numbers() == {"boot-0001": list(range(1, 11))}
    (surface, batch, _), *_ = live = [one for one in service.batches if not one[1].backlog]
    assert (surface, batch.boot_id, batch.channels, batch.backlog) == ("bench", "boot-0001", ["s1", "s2"], False)
    assert batch.samples[0].deflection_mm == [0.1, None]
    for (_, one, arrival_s), begin_s, age_s in zip(live, put_s, (0.4, 0.0), strict=True):
        assert one.newest_age_ms is not None
        assert age_s <= one.newest_age_ms / 1e3 <= age_s + arrival_s - begin_s
    assert (batch.oldest, batch.earlier) == (1, [])
    assert bench.logs.counts.published == 10


class Interrupting(Taken):
    """A sample at which the sender is interrupted, as by other programs."""

    @property
    def monotonic_s(self) -> float:
        sleep(0.2)
        return self.reading.monotonic_s


async def test_a_sender_that_is_interrupted_makes_no_sample_younger() -> None:
    (one,) = taken(1, 1)
    async with serving(Service()) as service, Bench(service) as bench:
        bench.put([Interrupting(one.reading, one.sample)])
        await service.until(1)
    batch = service.batches[0][1]
    assert batch.sent_us is not None
    assert batch.newest_age_ms is not None
    assert batch.sent_us / 1e6 - batch.newest_age_ms / 1e3 <= one.reading.monotonic_s + 0.001


async def test_a_sample_from_before_a_suspend_is_old(monkeypatch: pytest.MonkeyPatch) -> None:
    slept_s, waiting = 3600.0, taken(1, 1)
    monkeypatch.setattr("beamtouch_daemon.uptime.clock_gettime", lambda clock: clock_gettime(clock) + slept_s)
    async with serving(Service()) as service, Bench(service) as bench:
        bench.put(waiting)
        await service.until(1)
    age_ms = service.batches[0][1].newest_age_ms
    assert age_ms is not None
    assert slept_s <= age_ms / 1e3 < slept_s + 100


@pytest.mark.parametrize("status", [500, 503, 401, 302])
async def test_a_live_batch_that_fails_is_not_repeated_and_the_backlog_brings_it(status: int) -> None:
    service = Service()
    service.statuses = [status, status]
    async with serving(service), Bench(service) as bench:
        for _ in range(60):
            bench.count(3)
            await asyncio.sleep(0.01)
        await until(lambda: bench.log.is_empty)
    live = [batch for _, batch, _ in service.batches if not batch.backlog]
    backlog = [sample.sequence for _, batch, _ in service.batches if batch.backlog for sample in batch.samples]
    assert live[0].samples[0].sequence > 3
    assert backlog[0] == 1
    assert service.record.numbers() == {"boot-0001": list(range(1, 181))}
    assert bench.logs.counts.dropped == 0


async def test_after_an_outage_the_newest_samples_come_first(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO")
    service = Service(address := ("127.0.0.1", free_port()))
    service.listener.close()
    async with Bench(service) as bench:
        bench.count(3000)
        await until(lambda: "trying again" in caplog.text)
        bench.count(2500)
        assert bench.logs.counts.published == 0
        late = Service(address)
        async with serving(late):
            await until(lambda: bench.log.is_empty)
    live = [batch for _, batch, _ in late.batches if not batch.backlog]
    assert [sample.sequence for sample in live[0].samples] == list(range(5501 - MAX_BATCH, 5501))
    assert late.record.numbers() == {"boot-0001": list(range(1, 5501))}
    assert max(len(batch.samples) for _, batch, _ in late.batches) == MAX_BATCH
    assert bench.logs.counts.dropped == 0
    assert "works again after" in caplog.text


async def test_a_wrong_token_delivers_nothing_and_loses_nothing(caplog: pytest.LogCaptureFixture) -> None:
    async with serving(Service()) as service, Bench(service, token="wrong") as bench:  # noqa: S106
        bench.count(3)
        await until(lambda: service.attempts >= 3)
        assert bench.logs.refused == 1
    assert bench.log.in_memory == 3
    assert service.batches == []
    complaints = [record.getMessage() for record in caplog.records if "wrong token" in record.getMessage()]
    assert len(complaints) == 1


async def test_full_memory_drops_the_oldest_which_are_counted_and_lost_to_the_record(
    caplog: pytest.LogCaptureFixture,
) -> None:
    service = Service()
    service.problem_of = lambda *_: (503, "busy")
    async with serving(service), Bench(service, max_samples=100) as bench:
        bench.count(80)
        await until(lambda: service.attempts > 0)
        bench.count(80)
        service.problem_of = lambda *_: None
        await until(lambda: bench.log.is_empty)
    assert service.record.numbers() == {"boot-0001": list(range(61, 161))}
    assert service.record.lost["bench", "boot-0001"] == list(range(1, 61))
    assert (bench.logs.counts.dropped, bench.logs.counts.published) == (60, 100)
    assert "bench: 60 samples dropped" in caplog.text


async def test_samples_with_another_note_are_in_another_batch() -> None:
    async with serving(Service()) as service, Bench(service) as bench:
        bench.put([*taken(1, 3), *taken(4, 2, notes=(Note.RATE,)), *taken(6, 1)])
        await until(lambda: bench.log.is_empty)
    found = [(len(batch.samples), batch.notes) for _, batch, _ in service.batches if batch.samples]
    assert found == [(3, []), (2, ["rate"]), (1, [])]


async def test_a_disk_that_hangs_holds_up_no_new_samples(tmp_path: Path) -> None:
    await keep(tmp_path / "samples", 10)
    async with stored(tmp_path / "samples") as store:
        hangs = threading.Event()
        async with serving(Service()) as service, Bench(service, store) as bench:
            stuck = asyncio.ensure_future(_hang(store, hangs))
            try:
                for _ in range(30):
                    bench.count(1)
                    await asyncio.sleep(0.02)
                await until(lambda: len(service.record.numbers().get("boot-0001", [])) > 25)
                assert not service.record.numbers().get("boot-0000")
            finally:
                hangs.set()
                await stuck
            await until(lambda: bench.log.is_empty and not bench.logs.on_disk)
        assert service.record.numbers() == {"boot-0000": list(range(1, 11)), "boot-0001": list(range(1, 31))}


async def _hang(store: LogStore, hangs: threading.Event) -> None:
    await store._call(lambda _: hangs.wait(60))


async def test_answers_go_on_while_the_record_is_away_and_it_gets_everything_later() -> None:
    record = Record(is_away=True)
    async with serving(Service(record=record)) as service, Bench(service) as bench:
        begin_s = monotonic()
        for _ in range(100):
            bench.count(2)
            await asyncio.sleep(0.01)
        live = [batch for _, batch, _ in service.batches if not batch.backlog]
        assert len(live) > 10
        # It is asked seldom: after 0.1 s, after twice as long each time, then once a second.
        assert len(service.batches) - len(live) < 10 + (monotonic() - begin_s)
        assert (bench.log.in_memory, record.numbers()) == (200, {})
        record.is_away = False
        bench.count(1)
        await until(lambda: bench.log.is_empty)
    assert record.numbers() == {"boot-0001": list(range(1, 202))}
