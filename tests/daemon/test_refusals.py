"""Batches that a real HTTP server refuses: split, kept for another time, or set aside; and nothing waits for them."""

import asyncio
from itertools import count, pairwise
from pathlib import Path
from time import monotonic

import pytest

from beamtouch_daemon.delivery import late_delivery
from beamtouch_daemon.delivery.client import MISSING_CHANNELS, NEVER_ACCEPTED, TOO_LARGE
from beamtouch_daemon.delivery.spool import Spool
from beamtouch_service.problems import Kind
from beamtouch_service.samples import Batch

from .publishing import SENDER, Bench, put, sequences, taken, until
from .service import Service, serving

pytestmark = pytest.mark.anyio


def test_the_types_of_problems_are_those_of_the_service() -> None:
    assert Kind.TOO_LARGE.type_uri == TOO_LARGE
    assert Kind.MISSING_CHANNELS.type_uri == MISSING_CHANNELS
    assert {Kind.MALFORMED_JSON.type_uri, Kind.INVALID_REQUEST.type_uri} == NEVER_ACCEPTED


@pytest.mark.parametrize("kind", ["invalid-request", "malformed-json"])
async def test_a_batch_that_will_never_be_taken_is_kept_aside_and_does_not_stand_in_the_way(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, kind: str
) -> None:
    async def attempt(spool: Spool | None) -> Bench:
        service = Service()
        service.problem_of = lambda batch, _: (422, kind) if batch.samples[0].sequence == 0 else None
        async with serving(service), Bench(service, spool=spool) as bench:
            bench.outbox.put(taken(0, 3))
            while service.attempts < 1:  # noqa: ASYNC110 - the service is elsewhere
                await asyncio.sleep(0.01)
            bench.outbox.put(taken(3, 2))
            await service.until(2)
            await bench.finish()
            assert sequences(service) == [3, 4]
            return bench

    assert (await attempt(None)).outbox.dropped == 3
    with Spool(tmp_path / "spool", 10**6) as spool:
        assert (await attempt(spool)).outbox.dropped == 0
        assert (spool.set_aside["bench"], spool.waiting["bench"]) == (3, 0)
    assert sum("set aside: status 422: No." in record.getMessage() for record in caplog.records) == 1


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
        (504, PROXY),
    ],
)
async def test_a_batch_refused_for_now_is_kept_in_memory_or_on_disk(tmp_path: Path, status: int, kind: str) -> None:
    refuses, numbers = True, count(3)

    async def attempt(spool: Spool | None) -> None:
        nonlocal refuses
        refuses, service = True, Service()
        service.problem_of = lambda *_: (status, kind) if refuses else None
        async with serving(service), Bench(service, spool=spool) as bench:
            bench.outbox.put(taken(0, 3))
            while service.attempts < 3:
                await asyncio.sleep(0.01)
                if spool and not len(bench.outbox):
                    bench.outbox.put(taken(next(numbers), 1))
            refuses = False
            await service.until(3)
            assert bench.outbox.dropped == 0
            assert spool is None or spool.set_aside["bench"] == 0

    await attempt(None)
    with Spool(tmp_path / "spool", 10**6) as spool:
        await attempt(spool)


@pytest.mark.parametrize("kind", ["too-large", PROXY])
async def test_a_batch_that_is_too_large_is_split_live_and_from_the_disk(tmp_path: Path, kind: str) -> None:
    with Spool(tmp_path / "spool", 10**6) as spool:
        put(spool, 0, 100)
        newest_s = monotonic() - 60  # of the samples on the disk, or a little later
        service = Service()
        service.problem_of = lambda _, length: (413, kind) if length > 1000 else None
        async with serving(service), Bench(service, spool=spool) as bench:
            bench.outbox.put(taken(100, 50, age_s=0.5))
            await service.until(150)
            assert sorted(sequences(service)) == list(range(150))
            assert all(batch.newest_age_ms >= 500 for _, batch, _ in service.batches)
            assert bench.outbox.dropped == spool.set_aside["bench"] == 0
            await until(lambda: bench.publisher.spooled == 0 and bench.publisher.published == 150)
    # Each part has its age when it is sent, which is after the answer to the part before.
    parts = [(batch, arrival_s) for _, batch, arrival_s in service.batches if batch.boot_id == "boot-0000"]
    assert len(parts) > 4
    for (_, answered_s), (batch, _) in pairwise(parts):
        assert batch.newest_age_ms / 1e3 >= answered_s - newest_s


async def test_a_single_sample_that_is_too_large_is_kept_aside(tmp_path: Path) -> None:
    def problem(batch: Batch, _: int) -> tuple[int, str] | None:
        return (413, "too-large") if {7, 107} & {sample.sequence for sample in batch.samples} else None

    with Spool(tmp_path / "spool", 10**6) as spool:
        put(spool, 0, 10)
        service = Service()
        service.problem_of = problem
        async with serving(service), Bench(service, spool=spool) as bench:
            bench.outbox.put(taken(100, 10))
            await service.until(18)
            assert sorted(set(range(10)) - set(sequences(service))) == [7]
            assert sorted(set(range(100, 110)) - set(sequences(service))) == [107]
            await until(lambda: spool.set_aside["bench"] == 2)
            assert bench.publisher.published == 18
            assert bench.publisher.spooled == bench.outbox.dropped == 0


async def test_batches_of_another_models_channels_wait_and_let_others_pass(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(late_delivery, "PASSED_REST_S", 0.2)
    fits = False

    def problem(batch: Batch, _: int) -> tuple[int, str] | None:
        return None if fits or batch.channels == SENDER.channels else (422, "missing-channels")

    with Spool(tmp_path / "spool", 10**6) as spool:
        for first in (0, 10):
            put(spool, first, 10, channels=["s1", "s9"])
        put(spool, 20, 10)
        for first in (30, 40):
            put(spool, first, 10, channels=["s1", "s9"])
        service = Service()
        service.problem_of = problem
        async with serving(service), Bench(service, spool=spool) as bench:
            bench.outbox.put(taken(100, 5))
            await service.until(15)
            assert sorted(sequences(service)) == [*range(20, 30), *range(100, 105)]
            await until(lambda: service.attempts > 6)  # the first of those that wait, again and again
            assert bench.publisher.spooled == 40
            fits = True
            await service.until(55)
            assert sorted(sequences(service)) == [*range(50), *range(100, 105)]


async def test_a_batch_that_the_service_fails_on_lets_others_pass(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(late_delivery, "PASSED_REST_S", 0.2)
    fails = True

    def problem(batch: Batch, _: int) -> tuple[int, str] | None:
        return (500, "internal") if fails and batch.samples[0].sequence == 0 else None

    with Spool(tmp_path / "spool", 10**6) as spool:
        for first in (0, 10, 20):
            put(spool, first, 10)
        service = Service()
        service.problem_of = problem
        async with serving(service), Bench(service, spool=spool):
            await service.until(20)
            assert sequences(service) == list(range(10, 30))
            fails = False
            await service.until(30)


async def test_so_many_kinds_of_batches_are_passed_over_and_no_more(tmp_path: Path) -> None:
    attempts = list[str]()

    def problem(batch: Batch, _: int) -> tuple[int, str]:
        attempts.append(batch.channels[0])
        return 422, "missing-channels"

    with Spool(tmp_path / "spool", 10**6) as spool:
        kinds = [f"s{number}" for number in range(late_delivery.MAX_PASSED + 2)]
        for number, name in enumerate(kinds):
            put(spool, number, 1, [name, "other"])
        service = Service()
        service.problem_of = problem
        async with serving(service), Bench(service, spool=spool):
            await until(lambda: attempts.count(kinds[-2]) >= 3)
    assert kinds[-1] not in attempts
    assert spool.waiting["bench"] == len(kinds)
