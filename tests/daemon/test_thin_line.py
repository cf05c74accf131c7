"""A line that carries a little more than what is measured: answers stay fresh, and the record gets all of it."""

import asyncio
import random
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import pytest

from beamtouch_daemon.processing.pipeline import Taken
from beamtouch_service.samples import Quality, Sample
from thin_line import ThinLine, thin_line

from .publishing import Bench, boot, taken_of
from .service import Service, serving

pytestmark = [pytest.mark.anyio, pytest.mark.long]

CHANNELS = ["s1", "s2", "s3", "s4"]
RATE_HZ = 100
OUTAGE_S = 20
FRESH = RATE_HZ // 2
"""Newest samples among which an answer stands that is not stale."""


def measured(number: int, draws: random.Random) -> Taken:
    """Return a sample whose digits are noise, as those of a sensor are."""
    values = [draws.gauss(0.3, 0.01) for _ in CHANNELS]
    covariance = [
        float(f"{draws.uniform(1, 2) * (1e-6 if row == column else 1e-7):.4g}")
        for row in range(4)
        for column in range(row + 1)
    ]
    return taken_of(
        Sample(
            sequence=number,
            acquired_unix_us=1_795_218_046_123_000 + 10_000 * number,
            deflection_mm=[round(value, 6) for value in values],
            quality=[Quality.GOOD] * 4,
            readings=1 + number % 200,
            covariance_mm2=covariance,
        )
    )


@asynccontextmanager
async def measuring(bench: Bench) -> AsyncIterator[None]:
    """Add a sample each hundredth of a second."""
    draws = random.Random(1)  # noqa: S311  # noise, not secrets

    async def add() -> None:
        loop = asyncio.get_running_loop()
        due_s = loop.time()
        while True:
            bench.put([measured(bench.log.next, draws)])
            due_s += 1 / RATE_HZ
            await asyncio.sleep(due_s - loop.time())

    task = asyncio.ensure_future(add())
    try:
        yield
    finally:
        task.cancel()


async def freshness(service: Service, bench: Bench, seconds: float) -> list[int]:
    """Look ten times a second; return by how many samples the newest live one was behind each time."""
    behind = []
    for _ in range(round(10 * seconds)):
        await asyncio.sleep(0.1)
        newest = [batch.samples[-1].sequence for _, batch, _ in service.batches if batch.samples and not batch.backlog]
        behind.append(bench.log.next - 1 - newest[-1])
    return behind


async def outage(line: ThinLine) -> None:
    """Cut the line, and join it again."""
    await line.cut()
    await asyncio.sleep(OUTAGE_S)
    await line.open()


@pytest.mark.parametrize("bytes_s", [40_000, 60_000])
async def test_after_an_outage_a_thin_line_gives_fresh_answers_while_it_heals(bytes_s: int) -> None:
    async with (
        serving(Service()) as service,
        thin_line(int(service.url.rpartition(":")[2]), bytes_s) as line,
        Bench(service, head=boot(channels=CHANNELS), url=line.url) as bench,
        measuring(bench),
    ):
        await service.until(200)
        await outage(line)
        assert bench.log.in_memory > OUTAGE_S * RATE_HZ / 2
        await freshness(service, bench, 5.0)  # connections begin anew, and the line is learned
        behind = await freshness(service, bench, 20.0)
        assert bench.log.in_memory < FRESH
        await asyncio.sleep(0.1)
        last = bench.log.oldest - 1
        carried = line.up.carried
    assert service.record.numbers()["boot-0001"][:last] == list(range(1, last + 1))
    assert bench.logs.counts.dropped == 0
    assert sum(number < FRESH for number in behind) >= 0.98 * len(behind)
    assert carried / last < bytes_s / RATE_HZ
