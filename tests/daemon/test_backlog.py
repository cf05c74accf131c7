"""What the record lacks, against a real HTTP server that loses, refuses, forgets and dies."""

import asyncio
import random
from pathlib import Path
from time import monotonic

import pytest

from beamtouch_daemon.delivery.client import INVALID_REQUEST, NEVER_ACCEPTED, OTHER_BEAM, TOO_LARGE
from beamtouch_service.problems import Kind
from beamtouch_service.samples import Batch

from .faulty import soon
from .publishing import Bench, keep, stored, until
from .record import Record
from .service import Service, serving

pytestmark = pytest.mark.anyio


def test_the_types_of_problems_are_those_of_the_service() -> None:
    assert Kind.TOO_LARGE.type_uri == TOO_LARGE
    assert Kind.OTHER_BEAM.type_uri == OTHER_BEAM
    assert Kind.INVALID_REQUEST.type_uri == INVALID_REQUEST
    assert {Kind.MALFORMED_JSON.type_uri, INVALID_REQUEST, TOO_LARGE} == NEVER_ACCEPTED


def of_backlog(service: Service) -> list[Batch]:
    return [batch for _, batch, _ in service.batches if batch.backlog]


async def test_a_service_that_died_is_asked_within_a_second_and_gets_again_what_it_had_not_made_durable() -> None:
    async with serving(Service()) as service, Bench(service) as bench:
        service.commit_s = 60.0
        bench.count(50)
        await service.until(50)
        service.restart()
        service.commit_s = 0.0
        await soon(lambda: bench.log.is_empty, 5.0)
    assert service.record.numbers() == {"boot-0001": list(range(1, 51))}
    assert [len(batch.samples) for batch in of_backlog(service)][:2] == [0, 50]


async def test_a_backlog_has_no_age_and_says_what_there_is(tmp_path: Path) -> None:
    await keep(tmp_path / "samples", 300)
    async with stored(tmp_path / "samples") as store, serving(Service()) as service, Bench(service, store) as bench:
        service.problem_of = lambda _, length: (413, "too-large") if length > 5000 else None
        for _ in range(20):
            bench.count(1)
            await asyncio.sleep(0.02)
        await until(lambda: bench.log.is_empty and not bench.logs.on_disk)
    parts = [batch for batch in of_backlog(service) if batch.boot_id == "boot-0000" and batch.samples]
    assert len(parts) > 3  # in parts that the service takes, none of which looks younger than another
    assert all(batch.newest_age_ms is None and batch.sent_us is None for batch in of_backlog(service))
    assert parts[0].oldest == 1
    assert all(batch.earlier == ["boot-0001"] for batch in parts)
    live = [batch for _, batch, _ in service.batches if not batch.backlog]
    assert live[0].earlier == ["boot-0000"]
    assert service.record.numbers() == {"boot-0000": list(range(1, 301)), "boot-0001": list(range(1, 21))}
    assert bench.logs.counts.published == 320


PROXY = ""
"""The type of a problem that is none: a page of HTML."""


@pytest.mark.parametrize(
    ("status", "kind"),
    [
        (400, PROXY),
        (401, "unauthorized"),
        (403, "forbidden"),
        (404, "unknown-surface"),
        (413, PROXY),
        (422, PROXY),
        (422, "missing-channels"),
        (429, "too-many-requests"),
        (500, "internal"),
        (502, PROXY),
        (503, "busy"),
        (503, "other-beam"),
        (504, PROXY),
    ],
)
async def test_what_is_refused_for_now_waits(tmp_path: Path, status: int, kind: str) -> None:
    async with serving(Service()) as service, stored(tmp_path / "samples") as store, Bench(service, store) as bench:
        service.problem_of = lambda *_: (status, kind)
        bench.count(1)
        await until(lambda: service.attempts >= 3)
        await store.write(None)
        assert (bench.logs.on_disk, bench.logs.in_memory) == (1, 0)
        service.problem_of = lambda *_: None
        await until(lambda: bench.log.is_empty)
    assert service.record.numbers() == {"boot-0001": [1]}
    assert bench.logs.counts.dropped == bench.logs.refused == 0


@pytest.mark.parametrize(("status", "kind"), [(422, "invalid-request"), (400, "malformed-json"), (413, "too-large")])
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
        await until(lambda: service.attempts > 12 or (bench.logs.on_disk == 20 and bench.log.is_empty))
        await asyncio.sleep(1.0)
        bench.count(5)
        await until(lambda: bench.log.is_empty)
        assert service.record.numbers() == {"boot-000b": list(range(1, 21)), "boot-0001": list(range(1, 11))}
        assert (bench.logs.refused, bench.logs.on_disk) == (1, 20)
        fits = True
        await until(lambda: not bench.logs.on_disk)
        assert bench.logs.refused == 0
    assert service.record.numbers()["boot-000a"] == list(range(1, 21))
    named = [text for text in caplog.messages if "boot-000a" in text]
    assert named == [
        "bench: the samples of boot boot-000a wait, the service does not take them (status 422: No.)",
        "bench: the service takes the samples of boot boot-000a again",
    ]


async def test_a_record_that_takes_nothing_is_asked_less_and_less_often() -> None:
    async with serving(Service()) as service, Bench(service) as bench:
        service.commit_s = 60.0
        service.recorder.MAX_PENDING = 10
        begin_s = monotonic()
        bench.count(50)
        await until(lambda: len(of_backlog(service)) > 2)
        await asyncio.sleep(max(0.0, begin_s + 3.0 - monotonic()))
        assert len(of_backlog(service)) < 5 + monotonic() - begin_s
        service.commit_s = 0.0
        service.recorder.MAX_PENDING = 100
        await until(lambda: bench.log.is_empty)
    assert service.record.numbers() == {"boot-0001": list(range(1, 51))}


@pytest.mark.parametrize("seed", range(4))
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
                Bench(service, store, max_samples=400, boot_id=boot_id) as bench,
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
