"""Parts of the daemon that fail: each is named, restarted, and works once its fault is gone."""

import asyncio
from collections.abc import Container
from contextlib import closing
from pathlib import Path
from typing import NamedTuple

import httpx2
import pytest

from support.network.free_ports import free_port
from support.programs.broken import broken
from support.programs.service_manager import Manager
from support.surfaces import configs

from .devices import pymodbus_server
from .process import PATIENT_STOP, started, summary_of
from .service import Service, serving
from .waits import until

pytestmark = pytest.mark.anyio


class Case(NamedTuple):
    """A fault in a part."""

    part: str
    module: str
    owner: str
    function: str
    is_early: bool = False
    """True if the part calls the function only when it begins."""
    setup: str = ""
    """Code by which it calls the function soon."""


DELIVERY, RUNNING = "beamtouch_daemon.delivery", "beamtouch_daemon.running"
PARTS = [
    Case("bench readings", f"{RUNNING}.acquisition", "Acquisition", "_take"),
    Case("bench samples", "beamtouch_daemon.processing.pipeline", "Pipeline", "process"),
    Case("bench live", f"{DELIVERY}.client", "ServiceClient", "post_samples"),
    Case("bench backlog", f"{DELIVERY}.backlog", "Backlog", "run", is_early=True),
    Case("backlogs", f"{RUNNING}.daemon", "", "_deliver_backlogs", is_early=True),
    Case("log file", f"{DELIVERY}.log_store", "LogStore", "write"),
    Case(
        "zeros",
        f"{RUNNING}.kept_zeros",
        "KeptZeros",
        "write",
        setup=f"import {RUNNING}.kept_zeros as k; k.KEEP_S = 0.1",
    ),
    Case("metrics", f"{RUNNING}.metrics", "", "serve", is_early=True),
    Case("metrics", "socketserver", "BaseServer", "service_actions"),
    Case("watchdog", "beamtouch_common.systemd", "ServiceManager", "alive"),
]
WHILE_STOPPING = [
    Case("bench samples", f"{RUNNING}.acquisition", "Acquisition", "process"),
    Case("zeros", f"{RUNNING}.kept_zeros", "KeptZeros", "write"),
]
UNIT_AWAY = Case("bench readings", "beamtouch_daemon.sources.polled", "Part", "failed")
"""A fault in the task that tries a unit again which does not answer, beside one that does."""


def figure(text: str, name: str, part: str) -> float:
    """Return a metric of a part; -1 if there is none."""
    series = f'{name}{{part="{part}"}} '
    return next((float(line.removeprefix(series)) for line in text.splitlines() if series in line), -1.0)


async def wait_for(port: int, name: str, part: str, figures: Container[float]) -> None:
    """Wait until a metric of a part is one of these figures."""
    async with asyncio.timeout(60), httpx2.AsyncClient(trust_env=False) as client:
        while True:
            try:
                text = (await client.get(f"http://127.0.0.1:{port}/metrics")).text
            except httpx2.TransportError:
                await asyncio.sleep(0.05)
            else:
                if figure(text, name, part) in figures:
                    return


async def wait_for_status(manager: Manager, status: str) -> None:
    """Wait until the service manager hears this status as the newest one."""
    await until(
        lambda: next((line for line in reversed(manager.heard) if line.startswith("STATUS")), "") == f"STATUS={status}"
    )


@pytest.mark.parametrize("case", PARTS, ids=lambda case: f"{case.part} by {case.function}")
async def test_a_part_that_fails_is_named_and_works_again_once_its_fault_is_gone(tmp_path: Path, case: Case) -> None:
    fault, port, part = tmp_path / "fault", free_port(), case.part
    code = f"{PATIENT_STOP}\n{case.setup}\n{broken(case.module, case.owner, case.function, fault)}"
    if case.is_early:
        fault.touch()
    with closing(Manager(tmp_path)) as manager:
        heard = asyncio.create_task(asyncio.to_thread(manager.until, "STOPPING=1"))
        async with serving(Service()) as service, pymodbus_server([21_000, 20_000]) as device:
            config = configs.write(tmp_path, configs.surface(source=configs.tcp(device)), url=service.url)
            config.write_text(f"{config.read_text()}\n[metrics]\nport = {port}\n")
            async with started("run", config, code=f"{manager.code}\n{code}") as daemon:
                await service.until(10)
                fault.touch()
                if part != "metrics":
                    await wait_for(port, "beamtouch_part_failing", part, {1.0})
                    await wait_for(port, "beamtouch_part_failures_total", part, range(2, 10_000))
                if part != "watchdog":  # which states the status
                    state = "waiting for the device of" if part == "bench readings" else "reading"
                    await wait_for_status(manager, f"{state} bench; not tared: bench; unexpected error in {part}")
                fault.unlink()
                await wait_for(port, "beamtouch_part_failures_total", part, range(1, 10_000))
                await wait_for(port, "beamtouch_part_failing", part, {0.0})
                await wait_for_status(manager, "reading bench; not tared: bench")
                await service.until(len(service.samples()) + 100)
                outcome = await daemon.stop()
        assert await heard
    assert outcome.code == 0
    assert outcome.err.count(f"{part}: unexpected error; restarting in 0.1 s\n") == 1
    assert f"{part}: runs again" in outcome.err
    # What was taken is delivered.
    numbers = {sample.sequence for sample in service.samples()}
    assert numbers == set(range(1, max(numbers) + 1))


async def test_a_unit_that_is_tried_again_may_fail_like_any_part(tmp_path: Path) -> None:
    fault, port, part = tmp_path / "fault", free_port(), UNIT_AWAY.part
    async with serving(Service()) as service, pymodbus_server([21_000, 20_000]) as device:
        source = f'kind = "modbus-tcp"\nhost = "127.0.0.1"\nport = {device}\ntimeout_ms = 500'
        table = configs.surface(source=source).replace("register = 1", "register = 1\nunit = 9")
        config = configs.write(tmp_path, table, url=service.url)
        config.write_text(f"{config.read_text()}\n[metrics]\nport = {port}\n")
        async with started("run", config, code=broken(*UNIT_AWAY[1:4], fault)) as daemon:
            await service.until(50)
            fault.touch()
            await wait_for(port, "beamtouch_part_failures_total", part, range(2, 10_000))
            fault.unlink()
            await wait_for(port, "beamtouch_part_failing", part, {0.0})
            await service.until(len(service.samples()) + 20)
            outcome = await daemon.stop()
    assert "never retrieved" not in outcome.err
    assert outcome.err.count(f"{part}: unexpected error; restarting in 0.1 s\n") == 1


async def test_readings_that_an_error_keeps_from_the_samples_are_counted_as_lost(tmp_path: Path) -> None:
    fault = tmp_path / "fault"
    async with serving(Service()) as service, pymodbus_server([21_000, 20_000]) as device:
        config = configs.write(tmp_path, configs.surface(source=configs.tcp(device)), url=service.url)
        arguments = ("run", config, "--summary", tmp_path / "summary.json")
        code = broken("beamtouch_daemon.processing.pipeline", "Pipeline", "process", fault)
        async with started(*arguments, code=f"{PATIENT_STOP}\n{code}") as daemon:
            await service.until(10)
            fault.touch()
            await daemon.said("bench samples: unexpected error; restarting in 0.1 s\n")
            fault.unlink()
            await service.until(len(service.samples()) + 20)
            await daemon.stop()
    summary = summary_of(tmp_path)["bench"]
    assert summary["readings_lost"] >= 1


@pytest.mark.parametrize("case", WHILE_STOPPING, ids=lambda case: case.part)
async def test_an_error_while_the_daemon_stops_keeps_no_sample_from_the_service(tmp_path: Path, case: Case) -> None:
    fault = tmp_path / "fault"
    async with serving(Service()) as service, pymodbus_server([21_000, 20_000]) as device:
        config = configs.write(tmp_path, configs.surface(source=configs.tcp(device)), url=service.url)
        code = broken(case.module, case.owner, case.function, fault)
        async with started("run", config, code=f"{PATIENT_STOP}\n{code}") as daemon:
            await service.until(10)
            fault.touch()
            outcome = await daemon.stop()
    assert outcome.code == 0
    assert outcome.err.count(f"{case.part}: unexpected error while stopping\n") == 1
    numbers = {sample.sequence for sample in service.samples()}
    assert [sample.sequence for sample in service.record.whole()] == sorted(numbers)


async def test_reading_that_fails_again_and_again_does_not_have_the_whole_daemon_restarted(tmp_path: Path) -> None:
    fault = tmp_path / "fault"
    code = "from beamtouch_daemon.running import acquisition as a; a.PATIENCE_S = a.PATIENCE_PERIODS = 0.0"
    with closing(Manager(tmp_path)) as manager:
        async with serving(Service()) as service, pymodbus_server([21_000, 20_000]) as device:
            config = configs.write(tmp_path, configs.surface(source=configs.tcp(device)), url=service.url)
            fails = broken("beamtouch_daemon.running.acquisition", "Acquisition", "_take", fault)
            slow = "parts.FIRST_PAUSE_S = parts.LONGEST_PAUSE_S = 60.0; a.PATIENCE_TIMEOUTS = 1.0"
            async with started("run", config, code=f"{manager.code}\n{code}\n{fails}\n{slow}") as daemon:
                heard = asyncio.create_task(asyncio.to_thread(manager.until, "STOPPING=1"))
                await service.until(10)
                fault.touch()
                await wait_for_status(
                    manager, "waiting for the device of bench; not tared: bench; unexpected error in bench readings"
                )
                before = len(manager.heard)
                await asyncio.sleep(3)
                assert manager.heard[before:].count("WATCHDOG=1") > 5
                outcome = await daemon.stop()
                assert await heard
    assert "no progress on bench" not in outcome.err
