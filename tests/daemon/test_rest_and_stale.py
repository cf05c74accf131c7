"""Samples of a beam at rest: rare, but never so rare that the answer of the service grows stale."""

from pathlib import Path

import pytest

from support.surfaces import configs

from .devices import pymodbus_server
from .noisy_beam import NoisyBeam
from .process import started, summary_of
from .service import Service, serving

pytestmark = pytest.mark.anyio

REST_MS = 10_000
STALE_MS = 500.0
"""A fifth is 20 readings at 200 Hz."""


def write(folder: Path, port: int, url: str, rest_ms: float = REST_MS) -> Path:
    """Write a configuration by which a sample at rest is due every ten seconds."""
    surface = configs.surface(source=configs.tcp(port)).replace("rate_hz", "noise_mm = 0.002\nrate_hz", 1)
    surface = surface.replace('"moving-average"\nwindow = 1', '"growing-mean"\nmax_mean_ms = 20_000')
    config = configs.write(folder, surface, url=url)
    config.write_text(config.read_text().replace("batch_ms", f"rest_ms = {rest_ms}\nbatch_ms"))
    return config


@pytest.mark.promise(
    "docs/reference/daemon-configuration.md",
    "Time from one sample to the next while nothing changes, at most a fifth of `stale_ms` of the service.",
)
async def test_samples_at_rest_are_at_most_a_fifth_of_the_stale_time_apart(tmp_path: Path) -> None:
    beam = NoisyBeam()
    async with serving(Service()) as service, pymodbus_server([20_000, 20_000], beam.answer) as port:
        service.stale_ms = 60_000.0
        async with started("run", write(tmp_path, port, service.url)) as daemon:
            # With a long stale time, they become as rare as `rest_ms` says.
            await service.until(1)
            rare = False
            while not rare:
                sent = len(service.samples())
                await beam.asked(200)
                rare = len(service.samples()) - sent < 3
            # Each receipt states how long an answer may stand now: the newest one counts.
            service.stale_ms = STALE_MS
            sent = len(service.samples())
            await service.until(sent + 1)
            sent = len(service.samples())
            await beam.asked(400)
            # 400 readings are 20 fifths of the stale time: a busy machine has more time for each of them, not less.
            assert 8 <= len(service.samples()) - sent < 200
            assert (await daemon.stop()).code == 0


async def test_before_the_service_says_how_long_an_answer_may_stand_no_batch_waits(tmp_path: Path) -> None:
    beam = NoisyBeam()
    async with serving(Service()) as service, pymodbus_server([20_000, 20_000], beam.answer) as port:
        service.statuses = [503] * 100_000
        config = write(tmp_path, port, service.url)
        async with started("run", config, "--summary", tmp_path / "summary.json") as daemon:
            await beam.asked(800)
            assert (await daemon.stop()).code == 0
    summary = summary_of(tmp_path)["bench"]
    assert summary["readings"] >= 600
    # A batch at rest is one sample: of four readings, or of more on a busy machine.
    assert summary["samples_in_log"] > summary["readings"] / 12


@pytest.mark.promise("docs/reference/daemon-configuration.md", "0: a sample for each reading always.")
async def test_without_a_time_at_rest_each_reading_is_a_sample(tmp_path: Path) -> None:
    beam = NoisyBeam()
    async with serving(Service()) as service, pymodbus_server([20_000, 20_000], beam.answer) as port:
        config = write(tmp_path, port, service.url, rest_ms=0)
        async with started("run", config, "--summary", tmp_path / "summary.json") as daemon:
            await beam.asked(400)
            assert (await daemon.stop()).code == 0
    summary = summary_of(tmp_path)["bench"]
    assert summary["samples_published"] + summary["samples_in_log"] == summary["readings"] >= 300
