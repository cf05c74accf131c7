"""Batches for a real HTTP server that knows fewer keys than the daemon, or refuses a batch for another reason."""

import json
import logging
from dataclasses import replace
from pathlib import Path

import pytest

from beamtouch_daemon.delivery import known_keys
from beamtouch_daemon.delivery.client import UNKNOWN_KEY
from beamtouch_daemon.delivery.spool import Spool
from beamtouch_daemon.processing.pipeline import Taken
from beamtouch_service.api.samples import parse_batch
from beamtouch_service.problems import ProblemError
from beamtouch_service.samples import Batch, Note

from .publishing import SENDER, Bench, put, sequences, taken, until
from .service import Service, serving

pytestmark = pytest.mark.anyio

OLDER = {"readings", "covariance_mm2", "noise_mm", "characteristic"}
STATED = replace(SENDER, noise_mm=[0.01, 0.01], characteristic="bench-0001")


def moving(first: int, number: int, variance_mm2: float = 0.01) -> list[Taken]:
    stated = {"readings": 4, "covariance_mm2": [variance_mm2, 0.0, 0.0]}
    return [replace(one, sample=one.sample.model_copy(update=stated)) for one in taken(first, number)]


def test_the_service_says_of_an_unknown_key_what_the_daemon_looks_for() -> None:
    batch = Batch(boot_id="boot-0001", channels=["s1", "s2"], newest_age_ms=0, samples=[taken(0, 1)[0].sample])
    with pytest.raises(ProblemError) as error:
        parse_batch(json.dumps({**batch.model_dump(mode="json"), "new": 1}).encode())
    assert {"pointer": "#/new", "detail": UNKNOWN_KEY} in error.value.problem.members["errors"]  # type: ignore[operator]


async def test_a_refused_batch_is_never_sent_again_without_its_covariances() -> None:
    service = Service()
    service.problem_of = lambda batch, _: (422, "invalid-request") if batch.samples[0].sequence == 0 else None
    async with serving(service), Bench(service, sender=STATED) as bench:
        bench.outbox.put(moving(0, 3))
        await until(lambda: service.attempts >= 1)
        bench.outbox.put(moving(3, 3))
        await service.until(3)
        await bench.finish()
    assert sequences(service) == [3, 4, 5]
    assert bench.outbox.dropped == 3
    assert service.attempts == 2
    assert all(sample.covariance_mm2 for sample in service.samples())


@pytest.mark.parametrize("unknown", [OLDER, OLDER | {"notes"}, {"notes"}, {"covariance_mm2"}])
async def test_an_older_service_receives_the_keys_that_it_knows_and_is_asked_once(
    caplog: pytest.LogCaptureFixture, unknown: set[str]
) -> None:
    service = Service()
    service.unknown_keys = unknown
    async with serving(service), Bench(service, sender=STATED) as bench:
        for first in (0, 12, 24):
            bench.outbox.put([replace(one, notes=(Note.RATE,)) for one in moving(first, 12)])
            await service.until(first + 12)
        await bench.finish()
    assert sequences(service) == list(range(36))
    assert bench.outbox.dropped == 0
    assert service.attempts <= 3 + len(unknown)
    (line,) = [one.getMessage() for one in caplog.records if "does not know" in one.getMessage()]
    assert ", ".join(sorted(unknown)) in line
    _, batch, _ = service.batches[-1]
    assert (batch.noise_mm is None) == ("noise_mm" in unknown)
    assert (batch.samples[0].readings is None) == ("readings" in unknown)


@pytest.mark.parametrize(("variance_mm2", "notes"), [(0.01, [Note.RATE]), (0.01**2 / 4, [])])
async def test_an_older_service_is_told_of_a_moving_beam_by_the_note_that_it_knows(
    variance_mm2: float, notes: list[Note]
) -> None:
    service = Service()
    service.unknown_keys = OLDER
    async with serving(service), Bench(service, sender=STATED) as bench:
        bench.outbox.put(moving(0, 3, variance_mm2))
        await service.until(3)
        await bench.finish()
    assert [batch.notes for _, batch, _ in service.batches] == [notes]


@pytest.mark.parametrize("is_seen_to_fail", [True, False])
async def test_an_updated_service_receives_all_keys_again(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, *, is_seen_to_fail: bool
) -> None:
    caplog.set_level(logging.INFO)
    monkeypatch.setattr(known_keys, "ASK_AGAIN_S", 600.0 if is_seen_to_fail else 0.0)
    service = Service()
    service.unknown_keys = OLDER
    async with serving(service), Bench(service, sender=STATED) as bench:
        bench.outbox.put(moving(0, 3))
        await service.until(3)
        service.unknown_keys = set()
        service.statuses = [503] if is_seen_to_fail else []
        bench.outbox.put(moving(3, 3))
        await service.until(6)
        await bench.finish()
    assert [sample.covariance_mm2 is None for sample in service.samples()] == [True] * 3 + [False] * 3
    assert sum("knows all keys of a batch now" in one.getMessage() for one in caplog.records) == 1


async def test_spooled_batches_of_an_older_daemon_are_delivered_beside_present_ones(tmp_path: Path) -> None:
    with Spool(tmp_path / "spool", 10**6) as spool:
        put(spool, 100, 5)
        service = Service()
        async with serving(service), Bench(service, spool=spool, sender=STATED) as bench:
            bench.outbox.put(moving(0, 3))
            await service.until(8)
            await bench.finish()
    assert sorted(sequences(service)) == [0, 1, 2, *range(100, 105)]
    assert [sample.readings for sample in service.samples() if sample.sequence >= 100] == [None] * 5
