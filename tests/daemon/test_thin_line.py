"""A line that carries little, or takes long: answers stay fresh, and the record gets everything, each sample once."""

import asyncio
import re
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from itertools import pairwise
from pathlib import Path
from statistics import median

import httpx2
import numpy as np
import pytest

from beamtouch_daemon.processing.pipeline import TimedSample
from beamtouch_service.samples import Batch, Quality, Sample
from daemon.thin_line import ThinLine, thin_line
from support.network.plain_http import TIMEOUT_S
from support.surfaces import configs
from support.surfaces.small_model import write_model

from .devices import pymodbus_server
from .process import PATIENT_STOP, started, summary_of
from .publishing import Bench, boot, taken_of
from .service import Service, contact_has, real_service, serving
from .waits import until

pytestmark = [pytest.mark.anyio, pytest.mark.long]

CHANNELS = ["s1", "s2", "s3", "s4"]
LOOKS, LOOK_S = 60, 0.1


async def fresh_looks(url: str) -> int:
    """Return how many of `LOOKS` answers are fresh."""
    fresh = 0
    async with httpx2.AsyncClient(base_url=url, trust_env=False, timeout=TIMEOUT_S) as http:
        for _ in range(LOOKS):
            fresh += (await http.get("/contact")).is_success
            await asyncio.sleep(LOOK_S)
    return fresh


@pytest.mark.parametrize("is_cut", [pytest.param(True, marks=pytest.mark.soak), False], ids=["cut", "silent"])
async def test_after_an_outage_answers_are_fresh_and_the_record_gets_everything(
    tmp_path: Path, *, is_cut: bool
) -> None:
    """Samples of four channels, 200 a second, take two thirds of this line."""
    model = write_model(tmp_path, "bench", channels=4)
    async with (
        pymodbus_server([20_900] * 4) as device,
        real_service(tmp_path, model) as service,
        thin_line(int(service.rpartition(":")[2]), 15_000.0) as line,
    ):
        surface = configs.surface(source=configs.tcp(device), registers=(0, 1, 2, 3))
        config = configs.write(tmp_path, surface, url=line.url)
        async with started("run", config, "--summary", tmp_path / "summary.json", code=PATIENT_STOP) as daemon:
            await contact_has(service, "state", "contact")
            await line.cut() if is_cut else line.freeze()
            await asyncio.sleep(4.0)
            await line.open() if is_cut else line.thaw()
            await contact_has(service, "state", "contact")
            # While everything goes out both live and as a backlog, one look in ten is fresh.
            assert await fresh_looks(service) > LOOKS / 2
            assert (await daemon.stop()).code == 0
    counts = summary_of(tmp_path)["bench"]
    assert (counts["samples_dropped"], counts["samples_in_log"]) == (0, 0)
    assert counts["samples_published"] == counts["readings"]


def measured(number: int, draws: np.random.Generator) -> TimedSample:
    """Return a sample whose digits are noise, as those of a sensor are: of others, next to nothing travels."""
    return taken_of(
        Sample(
            sequence=number,
            acquired_unix_us=1_795_218_046_123_000 + 10_000 * number,
            deflection_mm=[round(float(draws.normal(0.3, 0.01)), 6) for _ in CHANNELS],
            quality=[Quality.GOOD] * 4,
            readings=1 + number % 200,
            covariance_mm2=[
                float(f"{draws.uniform(1, 2) * (1e-6 if row == column else 1e-7):.4g}")
                for row in range(4)
                for column in range(row + 1)
            ],
        )
    )


async def measure(bench: Bench, number: int) -> None:
    """Add samples, one each hundredth of a second."""
    draws = np.random.default_rng(1)
    for _ in range(number):
        bench.put([measured(bench.log.next, draws)])
        await asyncio.sleep(0.01)


@asynccontextmanager
async def bench_over(bytes_s: float, one_way_s: float = 0.0) -> AsyncIterator[tuple[Service, Bench, ThinLine]]:
    """Run a service, and what a daemon delivers to it over such a line."""
    async with (
        serving(Service()) as service,
        thin_line(service.port, bytes_s, one_way_s=one_way_s) as line,
        Bench(service, head=boot(channels=CHANNELS), url=line.url) as bench,
    ):
        yield service, bench, line


def recorded(number: int) -> dict[str, list[int]]:
    return {"boot-0001": list(range(1, number + 1))}


def backlog_of(service: Service) -> list[Batch]:
    return [batch for _, batch, _ in service.batches if batch.backlog and batch.samples]


async def test_on_a_thin_line_no_request_takes_long_and_little_travels_twice(caplog: pytest.LogCaptureFixture) -> None:
    async with bench_over(20_000.0) as (service, bench, _):
        service.problem_of = lambda *_: (503, "busy")
        await measure(bench, 200)
        draws = np.random.default_rng(2)
        bench.put([measured(bench.log.next + place, draws) for place in range(1000)])
        service.problem_of = lambda *_: None
        await measure(bench, 600)
        await until(lambda: bench.log.is_empty)
    assert service.record.numbers() == recorded(1800)
    assert len(service.samples()) < 1.2 * 1800
    assert re.search("bench: the line to the service is thin: .* and [0-9]{2,} wait for the record", caplog.text)


async def test_a_line_that_becomes_thinner_gets_smaller_requests() -> None:
    """At first some 150 samples take a quarter of a second, then some 40."""
    async with bench_over(40_000.0) as (service, bench, line):
        service.problem_of = lambda *_: (503, "busy")
        draws = np.random.default_rng(2)
        bench.put([measured(1 + place, draws) for place in range(2000)])
        service.problem_of = lambda *_: None
        await until(lambda: any(len(batch.samples) > 100 for batch in backlog_of(service)))
        line.up.bytes_s /= 4
        await until(lambda: bench.log.is_empty)
    assert service.record.numbers() == recorded(2000)
    *_, last = backlog_of(service)
    sizes = [len(batch.samples) for batch in backlog_of(service) if batch is not last]
    assert median(sizes[-5:]) < 80


async def test_on_a_long_way_a_live_batch_does_not_wait_for_the_answer_to_the_last_one() -> None:
    async with bench_over(1e6, one_way_s=0.25) as (service, bench, _):
        await measure(bench, 400)
        await until(lambda: bench.log.is_empty)
    assert service.record.numbers() == recorded(400)
    arrivals_s = [arrival_s for _, batch, arrival_s in service.batches if not batch.backlog]
    assert any(later_s - earlier_s < 0.5 for earlier_s, later_s in pairwise(arrivals_s))


async def test_a_service_that_takes_long_for_each_request_gets_large_ones() -> None:
    async with serving(Service()) as service, Bench(service) as bench:
        service.wait_s = lambda batch, _: 0.4 if batch.backlog and batch.samples else 0.0
        bench.count(5000)
        await until(lambda: bench.log.is_empty)
    assert service.record.numbers() == recorded(5000)
    assert len(backlog_of(service)) < 100


async def test_a_proxy_that_gives_up_on_what_takes_long_gets_less_at_a_time() -> None:
    async with serving(Service()) as service, Bench(service) as bench:
        service.wait_s = lambda _, length: 0.6 if length > 4000 else 0.0
        service.problem_of = lambda _, length: (504, "") if length > 4000 else None
        bench.count(400)
        await until(lambda: bench.log.is_empty)
    assert service.record.numbers() == recorded(400)
    assert bench.logs.counts.dropped == 0
