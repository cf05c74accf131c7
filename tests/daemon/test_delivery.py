"""Live samples, and what the record lacks, to a real HTTP server that is there, away, failing or forgetful."""

import asyncio
import random
import threading
from pathlib import Path
from time import clock_gettime, monotonic

import pytest

from beamtouch_daemon.delivery.log_file import Chunk
from beamtouch_daemon.delivery.log_store import LogStore
from beamtouch_service.samples import Batch, Note
from support.network.free_ports import free_port

from .faulty import soon
from .publishing import ROOM, Bench, Interrupting, boot, hang, keep, stored, taken
from .record import Record
from .service import Service, serving
from .waits import until

pytestmark = pytest.mark.anyio

MAX_BATCH = 250
"""Samples that the daemon sends at once, `docs/reference/http.md`."""


def live_of(service: Service) -> list[Batch]:
    return [batch for _, batch, _ in service.batches if not batch.backlog]


def backlog_of(service: Service) -> list[Batch]:
    return [batch for _, batch, _ in service.batches if batch.backlog]


@pytest.mark.promise(
    "docs/explanation/readings-to-samples.md",
    "The daemon keeps every sample until it is durable in the record of the service",
)
@pytest.mark.promise(
    "docs/reference/samples.md",
    "`newest_age_ms` is the age of the newest sample at the moment of sending.",
)
async def test_samples_arrive_once_and_in_order_with_their_age_and_are_forgotten_when_durable() -> None:
    async with serving(Service()) as service, Bench(service) as bench:
        put_s = [monotonic()]
        bench.count(5, age_s=0.4)
        await service.until(5)
        put_s.append(monotonic())
        bench.count(5)
        await until(lambda: bench.log.is_empty)
    assert [sample.sequence for sample in service.samples()] == list(range(1, 11))
    assert service.record.numbers() == {"boot-0001": list(range(1, 11))}
    (surface, batch, _), *_ = live = [one for one in service.batches if not one[1].backlog]
    assert (surface, batch.boot_id, batch.channels, batch.backlog) == ("bench", "boot-0001", ["s1", "s2"], False)
    assert batch.samples[0].deflection_mm == [0.1, None]
    for (_, one, arrival_s), begin_s, age_s in zip(live, put_s, (0.4, 0.0), strict=True):
        assert one.newest_age_ms is not None
        assert age_s <= one.newest_age_ms / 1e3 <= age_s + arrival_s - begin_s
    assert (batch.oldest, batch.earlier) == (1, [])
    assert bench.logs.counts.published == 10


@pytest.mark.promise("docs/reference/samples.md", "State it anew at each attempt.")
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
    monkeypatch.setattr("beamtouch_common.uptime.clock_gettime", lambda clock: clock_gettime(clock) + slept_s)
    async with serving(Service()) as service, Bench(service) as bench:
        bench.put(waiting)
        await service.until(1)
    assert (live_of(service)[0].newest_age_ms or 0.0) >= slept_s * 1e3


@pytest.mark.promise(
    "docs/reference/events.md",
    "and the daemon keeps each sample until it is on record. So an outage costs no event.",
)
@pytest.mark.parametrize("status", [500, 302])
async def test_a_live_batch_that_fails_is_not_repeated_and_the_backlog_brings_it(status: int) -> None:
    service = Service()
    service.statuses = [status, status]
    async with serving(service), Bench(service) as bench:
        for _ in range(60):
            bench.count(3)
            await asyncio.sleep(0.01)
        await until(lambda: bench.log.is_empty)
    assert live_of(service)[0].samples[0].sequence > 3
    assert next(batch for batch in backlog_of(service) if batch.samples).samples[0].sequence == 1
    assert service.record.numbers() == {"boot-0001": list(range(1, 181))}
    assert bench.logs.counts.dropped == 0


@pytest.mark.promise(
    "docs/explanation/readings-to-samples.md",
    "New samples go out first, and beside them what the record lacks.",
)
@pytest.mark.promise("docs/reference/http.md", "the daemon sends at most 250")
async def test_after_an_outage_the_newest_samples_come_first(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO")
    service = Service(address := ("127.0.0.1", free_port()))
    service.listener.close()
    async with Bench(service) as bench:
        bench.count(1500)
        await until(lambda: "trying again" in caplog.text)
        bench.count(1000)
        assert bench.logs.counts.published == 0
        late = Service(address)
        async with serving(late):
            await until(lambda: bench.log.is_empty)
    newest = [sample.sequence for sample in live_of(late)[0].samples]
    assert newest == list(range(2501 - len(newest), 2501))
    assert 1 <= len(newest) <= MAX_BATCH / 10  # nothing is known of the line yet: what the newest answer needs
    assert late.record.numbers() == {"boot-0001": list(range(1, 2501))}
    assert max(len(batch.samples) for _, batch, _ in late.batches) == MAX_BATCH
    assert bench.logs.counts.dropped == 0
    assert "works again after" in caplog.text


@pytest.mark.promise("docs/reference/daemon-configuration.md", "beyond it the oldest are dropped and counted.")
@pytest.mark.promise(
    "docs/explanation/readings-to-samples.md",
    "beyond that, the oldest samples are dropped and counted",
)
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


async def test_samples_with_another_note_are_in_another_batch_with_an_age_of_its_own() -> None:
    async with serving(Service()) as service, Bench(service) as bench:
        bench.put([*taken(1, 3, age_s=2.0), *taken(4, 2, notes=(Note.RATE,)), *taken(6, 1)])
        await until(lambda: bench.log.is_empty)
    assert (live_of(service)[0].newest_age_ms or 0.0) >= 2000
    found = [(len(batch.samples), batch.notes) for _, batch, _ in service.batches if batch.samples]
    assert found == [(3, []), (2, ["rate"]), (1, [])]


async def test_a_disk_that_hangs_holds_up_no_new_samples(tmp_path: Path) -> None:
    await keep(tmp_path / "samples", 10)
    async with stored(tmp_path / "samples") as store:
        hangs = threading.Event()
        async with serving(Service()) as service, Bench(service, store) as bench:
            stuck = asyncio.ensure_future(hang(store, hangs))
            try:
                for number in range(1, 31):
                    bench.count(1)
                    await service.until(number)
                service.recorder.commit()  # by itself, as a real one does: what else would ask waits for the disk
                assert len(service.record.numbers()["boot-0001"]) > 25
                assert not service.record.numbers().get("boot-0000")
            finally:
                hangs.set()
                await stuck
            await until(lambda: bench.log.is_empty and not bench.logs.on_disk)
        assert service.record.numbers() == {"boot-0000": list(range(1, 11)), "boot-0001": list(range(1, 31))}


@pytest.mark.parametrize("statuses", [[], [500]], ids=["", "after a failure"])
async def test_answers_go_on_while_the_record_is_away_and_it_gets_everything_later(statuses: list[int]) -> None:
    record = Record(is_away=True)
    async with serving(Service(record=record)) as service, Bench(service) as bench:
        service.statuses = statuses
        begin_s = monotonic()
        for _ in range(100):
            bench.count(2)
            await asyncio.sleep(0.01)
        assert len(live_of(service)) > 10
        # It is asked seldom: after 0.1 s, after twice as long each time, then once a second.
        assert len(backlog_of(service)) < 10 + (monotonic() - begin_s)
        assert (bench.log.in_memory, record.numbers()) == (200, {})
        record.is_away = False
        bench.count(1)
        await until(lambda: bench.log.is_empty)
    assert record.numbers() == {"boot-0001": list(range(1, 202))}


async def test_a_service_that_died_is_asked_within_a_second_and_gets_again_what_it_had_not_made_durable() -> None:
    async with serving(Service()) as service, Bench(service) as bench:
        service.commit_s = 60.0
        bench.count(10)
        await service.until(10)
        service.restart()
        service.commit_s = 0.0
        await soon(lambda: bench.log.is_empty, 5.0)
    assert service.record.numbers() == {"boot-0001": list(range(1, 11))}
    assert [len(batch.samples) for batch in backlog_of(service)][:2] == [0, 10]


async def test_a_stop_also_delivers_the_boots_of_a_file_that_is_opened_meanwhile(tmp_path: Path) -> None:
    await keep(tmp_path / "samples", 10)
    store, service = LogStore(tmp_path / "samples", ROOM), Service()
    async with serving(service), Bench(service, store) as bench:
        service.commit_s = 60.0
        bench.count(5)
        await service.until(5)
        stop = asyncio.ensure_future(bench.backlog.finish())
        attempts = service.attempts
        await until(lambda: service.attempts > attempts)  # it waits for these five to be durable
        attempts = service.attempts
        await asyncio.sleep(0.6)
        assert service.attempts <= attempts + 4  # it asks five times a second
        await store.open()
        service.commit_s = 0.0
        await stop
        await store.close()
    assert service.record.numbers() == {"boot-0000": list(range(1, 11)), "boot-0001": list(range(1, 6))}


async def test_a_backlog_has_no_age_and_says_what_there_is(tmp_path: Path) -> None:
    await keep(tmp_path / "samples", 300)
    async with stored(tmp_path / "samples") as store, serving(Service()) as service, Bench(service, store) as bench:
        service.problem_of = lambda _, length: (413, "too-large") if length > 5000 else None
        for number in range(1, 21):
            bench.count(1)
            await until(lambda number=number: bench.boot.live.first > number)  # type: ignore[misc]
        await until(lambda: bench.log.is_empty and not bench.logs.on_disk)
    parts = [batch for batch in backlog_of(service) if batch.boot_id == "boot-0000" and batch.samples]
    assert len(parts) > 3  # in parts that the service takes, none of which looks younger than another
    assert all(batch.newest_age_ms is None and batch.sent_us is None for batch in backlog_of(service))
    assert parts[0].oldest == 1
    assert all(batch.earlier == ["boot-0001"] for batch in parts)
    assert live_of(service)[0].earlier == ["boot-0000"]
    assert service.record.numbers() == {"boot-0000": list(range(1, 301)), "boot-0001": list(range(1, 21))}
    assert bench.logs.counts.published == 320


PROXY = ""
"""The type of a problem that is none: a page of HTML."""


@pytest.mark.promise(
    "docs/explanation/readings-to-samples.md",
    (
        "If the service refuses all samples, because of a token, the channels or another beam, they wait in the log "
        "(`beamtouch_boots_refused`)."
    ),
)
@pytest.mark.parametrize(
    ("status", "kind"),
    [
        (401, "unauthorized"),
        (404, "unknown-surface"),
        (413, PROXY),
        (422, "missing-channels"),
        (503, "other-beam"),
    ],
)
async def test_what_is_refused_for_now_waits(tmp_path: Path, status: int, kind: str) -> None:
    async with serving(Service()) as service, stored(tmp_path / "samples") as store, Bench(service, store) as bench:
        service.problem_of = lambda *_: (status, kind)
        bench.count(1)
        await until(lambda: service.attempts >= 3)
        await store.write(None)
        assert (bench.logs.on_disk, bench.logs.in_memory, bench.logs.refused) == (1, 0, 1)
        service.problem_of = lambda *_: None
        await until(lambda: bench.log.is_empty)
    assert service.record.numbers() == {"boot-0001": [1]}
    assert bench.logs.counts.dropped == bench.logs.refused == 0


async def test_a_sample_that_only_a_proxy_refuses_waits(tmp_path: Path) -> None:
    """The question how far the record is, without samples, is small enough for it."""
    async with serving(Service()) as service, stored(tmp_path / "samples") as store, Bench(service, store) as bench:
        service.problem_of = lambda batch, _: (413, PROXY) if batch.samples else None
        bench.count(3)
        await until(lambda: bool(bench.logs.refused or bench.logs.counts.dropped))
        service.problem_of = lambda *_: None
        await until(lambda: bench.log.is_empty)
    assert service.record.numbers() == {"boot-0001": [1, 2, 3]}
    assert bench.logs.counts.dropped == 0


@pytest.mark.promise(
    "docs/explanation/readings-to-samples.md",
    "A single sample that the service refuses is dropped and named in the messages.",
)
@pytest.mark.parametrize(("status", "kind"), [(422, "invalid-request"), (413, "too-large")])
async def test_a_sample_that_is_refused_alone_is_dropped_and_counted_and_the_others_are_recorded(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, status: int, kind: str
) -> None:
    def problem(batch: Batch, _: int) -> tuple[int, str] | None:
        bad = {7} if batch.boot_id == "boot-0000" else {3, 4}
        return (status, kind) if bad & {sample.sequence for sample in batch.samples} else None

    await keep(tmp_path / "samples", 10)
    async with stored(tmp_path / "samples") as store, serving(Service()) as service, Bench(service, store) as bench:
        service.problem_of = problem
        bench.count(10)
        await until(lambda: bench.log.is_empty and not bench.logs.on_disk)
    assert service.record.numbers() == {"boot-0000": [*range(1, 7), 8, 9, 10], "boot-0001": [1, 2, *range(5, 11)]}
    assert service.record.lost == {("bench", "boot-0000"): [7], ("bench", "boot-0001"): [3, 4]}
    assert (bench.logs.counts.dropped, bench.logs.counts.published) == (3, 17)
    assert sorted(text for text in caplog.messages if "is dropped" in text) == [
        f"bench: sample {number} is dropped: status {status}: No." for number in (3, 4, 7)
    ]


async def test_a_boot_that_is_refused_holds_up_no_other_and_is_named_once(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("INFO")
    fits = False

    def problem(batch: Batch, _: int) -> tuple[int, str] | None:
        return None if fits or batch.channels == ["s1", "s2"] else (422, "missing-channels")

    await keep(tmp_path / "samples", 20, boot_id="boot-000a", channels=["s1", "s9"])
    await keep(tmp_path / "samples", 20, boot_id="boot-000b")
    async with stored(tmp_path / "samples") as store, serving(Service()) as service, Bench(service, store) as bench:
        service.problem_of = problem
        bench.count(5)
        await until(lambda: bench.logs.on_disk == 20 and bench.log.is_empty and bench.logs.refused == 1)
        attempts = service.attempts
        await until(lambda: service.attempts > attempts + 1)  # it is refused again
        bench.count(5)
        await until(lambda: bench.log.is_empty)
        assert service.record.numbers() == {"boot-000b": list(range(1, 21)), "boot-0001": list(range(1, 11))}
        assert (bench.logs.refused, bench.logs.on_disk) == (1, 20)
        fits = True
        await until(lambda: not bench.logs.on_disk)
        assert bench.logs.refused == 0
    assert service.record.numbers()["boot-000a"] == list(range(1, 21))
    assert [text for text in caplog.messages if "boot-000a" in text] == [
        "bench: the samples of boot boot-000a wait, the service does not take them (status 422: No.)",
        "bench: the service takes the samples of boot boot-000a again",
    ]


@pytest.mark.parametrize("seed", [0, 1, *(pytest.param(seed, marks=pytest.mark.soak) for seed in range(2, 12))])
async def test_a_course_of_random_faults_leaves_every_sample_in_the_record_once_and_in_order(
    tmp_path: Path, seed: int
) -> None:
    chance, record, made = random.Random(seed), Record(), dict[str, int]()  # noqa: S311 - noise, not secrets
    service = Service(record=record)

    def fault(*_: object) -> tuple[int, str] | None:
        service.loses_receipts = chance.random() < 0.2
        if chance.random() < 0.05:
            service.restart()
        record.is_away = chance.random() < (0.5 if record.is_away else 0.05)
        return (503, "busy") if chance.random() < 0.2 else None

    service.problem_of = fault
    dropped = 0
    async with serving(service):
        for boot_id in ("boot-0000", "boot-0001", "boot-0002"):
            async with (
                stored(tmp_path / "samples") as store,
                Bench(service, store, max_samples=400, head=boot(boot_id)) as bench,
            ):
                for _ in range(60):
                    bench.count(chance.randrange(1, 12))
                    await asyncio.sleep(0.01)
                    if chance.random() < 0.1:
                        await store.write(chance.choice([0.0, 5.0]))
                made[boot_id] = bench.log.next - 1
                if boot_id == "boot-0002":
                    service.problem_of = lambda *_: None
                    record.is_away = service.loses_receipts = False
                    await until(lambda: not bench.logs.on_disk + bench.logs.in_memory)
            dropped += bench.logs.counts.dropped
    lost = {boot: numbers for (_, boot), numbers in record.lost.items()}
    for boot_id, number in made.items():
        assert sorted(record.numbers()[boot_id] + lost[boot_id]) == list(range(1, number + 1))
        assert record.numbers()[boot_id] == sorted(record.numbers()[boot_id])
    assert sum(map(len, lost.values())) <= dropped


class CountingStore(LogStore):
    """A log file that counts what is read from it."""

    reads = 0

    async def read(self, chunk: Chunk) -> Batch | None:
        self.reads += 1
        return await super().read(chunk)


async def test_a_chunk_that_goes_out_in_many_requests_is_read_once(tmp_path: Path) -> None:
    await keep(tmp_path / "samples", 6)
    store = CountingStore(tmp_path / "samples", ROOM)
    await store.open()
    async with serving(Service()) as service, Bench(service, store) as bench:
        service.problem_of = lambda batch, _: (413, "too-large") if len(batch.samples) > 1 else None
        await until(lambda: not bench.logs.on_disk)
    await store.close()
    assert service.record.numbers() == {"boot-0000": list(range(1, 7))}
    assert store.reads == 1
