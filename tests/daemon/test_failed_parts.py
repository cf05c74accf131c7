"""Parts of the daemon that fail: each is named, begun again, and works once its fault is gone."""

import asyncio
from collections.abc import Container
from pathlib import Path
from typing import NamedTuple

import httpx2
import pytest

from support.network.free_ports import free_port
from support.programs.broken import broken
from support.surfaces import configs

from .devices import pymodbus_server
from .process import PATIENT_STOP, started
from .service import Service, serving

pytestmark = pytest.mark.anyio


class Case(NamedTuple):
    """A fault in a part."""

    part: str
    module: str
    owner: str
    function: str
    is_early: bool = False
    """Whether the part calls the function only when it begins."""


PARTS = [
    Case("bench readings", "beamtouch_daemon.running.acquisition", "Acquisition", "_take"),
    Case("bench samples", "beamtouch_daemon.processing.pipeline", "Pipeline", "process"),
    Case("bench live", "beamtouch_daemon.delivery.client", "ServiceClient", "post_samples"),
    Case("backlogs", "beamtouch_daemon.running.daemon", "", "_deliver_backlogs", is_early=True),
    Case("log file", "beamtouch_daemon.delivery.log_store", "LogStore", "write"),
    Case("watchdog", "beamtouch_common.systemd", "ServiceManager", "alive"),
]


async def wait_for(port: int, name: str, part: str, figures: Container[float]) -> None:
    """Wait until a metric of a part is one of these figures."""
    series, found = f'{name}{{part="{part}"}} ', -1.0
    async with asyncio.timeout(60), httpx2.AsyncClient(trust_env=False) as client:
        while found not in figures:
            try:
                text = (await client.get(f"http://127.0.0.1:{port}/metrics")).text
            except httpx2.TransportError:
                await asyncio.sleep(0.05)
            else:
                found = next((float(line.removeprefix(series)) for line in text.splitlines() if series in line), -1.0)


@pytest.mark.parametrize("case", PARTS, ids=lambda case: case.part)
async def test_a_part_that_fails_is_named_and_works_again_once_its_fault_is_gone(tmp_path: Path, case: Case) -> None:
    fault, port, part = tmp_path / "fault", free_port(), case.part
    code = f"{PATIENT_STOP}\n{broken(case.module, case.owner, case.function, fault)}"
    if case.is_early:
        fault.touch()
    async with serving(Service()) as service, pymodbus_server([21_000, 20_000]) as device:
        config = configs.write(tmp_path, configs.surface(source=configs.tcp(device)), url=service.url)
        config.write_text(f"{config.read_text()}\n[metrics]\nport = {port}\n")
        async with started("run", config, code=code) as daemon:
            await service.until(10)
            fault.touch()
            await wait_for(port, "beamtouch_part_failing", part, {1.0})
            await wait_for(port, "beamtouch_part_failures_total", part, range(2, 10_000))
            fault.unlink()
            await wait_for(port, "beamtouch_part_failing", part, {0.0})
            await service.until(len(service.samples()) + 100)
            outcome = await daemon.stop()
    assert outcome.code == 0
    assert outcome.err.count(f"{part}: unexpected error; restarting in 0.1 s\n") == 1
    assert f"{part}: runs again" in outcome.err
    # What was taken is delivered.
    numbers = {sample.sequence for sample in service.samples()}
    assert numbers == set(range(1, max(numbers) + 1))
