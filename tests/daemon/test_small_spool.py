"""A spool that takes nothing: it is smaller than a single sample, or its file is damaged while samples are sent."""

import sqlite3
from contextlib import closing
from pathlib import Path

import pytest

from beamtouch_daemon.delivery.spool import Spool

from .publishing import Bench, put, sequences, taken, until
from .service import Service, serving

pytestmark = pytest.mark.anyio

LITTLE = 100
"""Bytes, less than a sample."""


async def test_samples_larger_than_the_spool_are_dropped_and_counted_and_the_next_are_sent(tmp_path: Path) -> None:
    with Spool(tmp_path / "spool", LITTLE) as spool:
        service = Service()
        service.problem_of = lambda *_: (503, "busy")
        async with serving(service), Bench(service, spool=spool) as bench:
            bench.outbox.put(taken(0, 5))
            await until(lambda: bench.outbox.dropped == 5)
            service.problem_of = lambda *_: None
            bench.outbox.put(taken(5, 3))
            await service.until(3)
    assert sequences(service) == [5, 6, 7]
    assert spool.waiting["bench"] == spool.set_aside["bench"] == 0


async def test_a_refused_batch_that_no_disk_keeps_is_counted_and_does_not_stand_in_the_way(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with Spool(tmp_path / "spool", LITTLE) as spool:
        service = Service()
        service.problem_of = lambda batch, _: (422, "invalid-request") if batch.samples[0].sequence == 0 else None
        async with serving(service), Bench(service, spool=spool) as bench:
            bench.outbox.put(taken(0, 5))
            await until(lambda: bench.outbox.dropped == 5)
            bench.outbox.put(taken(5, 3))
            await service.until(3)
    assert sequences(service) == [5, 6, 7]
    assert "bytes is larger than the spool" in caplog.text


async def test_a_spool_that_is_damaged_while_it_is_sent_is_rescued_and_sent_on(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path, rows = tmp_path / "spool", 40
    with Spool(path, 10**8) as spool:
        for number in range(rows):
            put(spool, 1000 * number, 1000)
        pages = path.stat().st_size // 4096
        with path.open("r+b") as file:
            file.seek(pages // 2 * 4096)
            file.write(b"\x55" * 8 * 4096)
        service = Service()
        async with serving(service), Bench(service, spool=spool):
            await until(lambda: spool.waiting["bench"] == 0)
    found = {sample.sequence // 1000 for sample in service.samples()}
    assert rows - 5 < len(found) < rows
    assert spool.set_aside["bench"] == 1000 * (rows - len(found))
    assert "cannot read the spool: " in caplog.text
    with closing(sqlite3.connect(path)) as database:
        assert database.execute("PRAGMA quick_check").fetchone() == ("ok",)
