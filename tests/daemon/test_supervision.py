"""What keeps the daemon going for a year: the service manager, metrics, logs, the unit file."""

import asyncio
import json
import re
import socket
import subprocess
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import httpx2
import pytest
from prometheus_client.parser import text_string_to_metric_families

from beamtouch_daemon.config.sources import ModbusRtu
from beamtouch_daemon.running.acquisition import PATIENCE_S, Acquisition
from beamtouch_daemon.sources.rtu_bus import REST_TIMEOUTS
from free_ports import free_port
from parts import require

from . import configs
from .devices import pymodbus_server
from .faulty import LOG_FILE
from .process import started
from .publishing import keep
from .service import Service, serving

pytestmark = pytest.mark.anyio

UNIT = Path(__file__).parents[2] / "daemon" / "beamtouch-daemon.service"


class Manager:
    """Hears what a service manager would."""

    def __init__(self, folder: Path) -> None:
        self.path = folder / "notify"
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.bind(str(self.path))
        self._socket.setblocking(False)
        self.heard: list[str] = []

    async def until(self, word: str, more: int = 1) -> None:
        """Wait for a word to be heard so many more times."""
        wanted = self._count(word) + more
        async with asyncio.timeout(60):
            while self._count(word) < wanted:
                try:
                    self.heard += self._socket.recv(4096).decode().splitlines()
                except BlockingIOError:
                    await asyncio.sleep(0.02)

    def close(self) -> None:
        self._socket.close()

    def _count(self, word: str) -> int:
        return sum(line.startswith(word) for line in self.heard)


async def test_the_service_manager_is_told_of_start_progress_and_stop(tmp_path: Path) -> None:
    with closing(Manager(tmp_path)) as manager:
        environment = {"NOTIFY_SOCKET": str(manager.path), "WATCHDOG_USEC": "400000"}
        async with serving(Service()) as service, pymodbus_server([21_000, 65_535]) as port:
            config = configs.write(tmp_path, configs.surface(source=configs.tcp(port)), url=service.url)
            async with started("run", config, environment=environment) as daemon:
                await manager.until("READY=1")
                await manager.until("WATCHDOG=1", more=5)
                outcome = await daemon.stop()
                await manager.until("STOPPING=1")
    assert outcome.code == 0
    assert manager.heard[0] == "READY=1"
    assert "STATUS=reading bench" in manager.heard


def test_a_line_without_progress_hangs_and_one_without_a_device_does_not() -> None:
    def line(turned_s: float, rate_hz: float = 100.0, timeout_ms: float = 1.0) -> Acquisition:
        source = ModbusRtu(kind="modbus-rtu", port="/dev/ttyUSB0", timeout_ms=timeout_ms)
        found = SimpleNamespace(surface=SimpleNamespace(rate_hz=rate_hz, source=source), turned_s=turned_s)
        return cast("Acquisition", found)

    now_s, long_ago_s = 1000.0, 1000.0 - PATIENCE_S - 1
    hangs: Callable[[Acquisition, float], bool] = Acquisition.hangs
    assert not hangs(line(now_s), now_s)
    assert hangs(line(long_ago_s), now_s)  # reading stands still
    assert not hangs(line(long_ago_s, rate_hz=0.1), now_s)  # it reads that seldom
    rested_s = now_s - (REST_TIMEOUTS + 1) * 4.0
    assert not hangs(line(rested_s, timeout_ms=4000.0), now_s)  # a unit that is off is asked that seldom


async def test_metrics_are_those_of_the_summary_and_only_on_this_machine(tmp_path: Path) -> None:
    port = free_port()
    async with serving(Service()) as service, pymodbus_server([21_000, 65_535]) as device:
        config = configs.write(tmp_path, configs.surface(source=configs.tcp(device)), url=service.url)
        config.write_text(config.read_text() + f"\n[metrics]\nport = {port}\n")
        await keep(tmp_path / LOG_FILE, 7)
        service.problem_of = lambda batch, _: (422, "missing-channels") if batch.boot_id == "boot-0000" else None
        async with started("run", config) as daemon, httpx2.AsyncClient(trust_env=False) as client:
            await service.until(400)
            async with asyncio.timeout(60):
                answer = await client.get(f"http://127.0.0.1:{port}/metrics")
                while 'boots_refused{surface="bench"} 1.0' not in answer.text:
                    await asyncio.sleep(0.05)
                    answer = await client.get(f"http://127.0.0.1:{port}/metrics")
            with pytest.raises(httpx2.ConnectError):
                await client.get(f"http://127.0.0.2:{port}/metrics")
            assert (await daemon.stop()).code == 0
    found = {
        (sample.name, sample.labels.get("where", sample.labels["surface"])): sample.value
        for family in text_string_to_metric_families(answer.text)
        for sample in family.samples
    }
    assert found["beamtouch_readings_total", "bench"] >= 100
    assert 0 < found["beamtouch_samples_published_total", "bench"] <= found["beamtouch_readings_total", "bench"]
    assert found["beamtouch_samples_dropped_total", "bench"] == 0
    assert found["beamtouch_samples_in_log", "disk"] == 7
    assert 0 <= found["beamtouch_reading_age_seconds", "bench"] < 5
    assert ("beamtouch_samples_in_log", "memory") in found
    assert 0 < found["beamtouch_readings_per_second", "bench"] < 210
    assert found["beamtouch_rate_wrong", "bench"] in {0, 1}


async def test_the_log_as_json_is_one_object_per_line(tmp_path: Path) -> None:
    polls = [0]

    async def action(*_: object) -> None:
        polls[0] += 1

    url = f"http://127.0.0.1:{free_port()}"
    async with pymodbus_server([21_000, 65_535], action) as port:
        config = configs.write(tmp_path, configs.surface(source=configs.tcp(port)), url=url)
        async with started("run", "--log-format", "json", config) as daemon, asyncio.timeout(60):
            while polls[0] < 300:  # noqa: ASYNC110 - the daemon is outside
                await asyncio.sleep(0.05)
            outcome = await daemon.stop()
    *events, summary = outcome.err.splitlines()
    assert summary.startswith("bench: ")
    found: list[dict[str, Any]] = [json.loads(event) for event in events]
    assert all(set(event) == {"time", "level", "source", "message"} for event in found)
    assert {event["level"] for event in found} == {"info", "warning"}
    assert len(found) < 6  # of 300 readings and several attempts


def test_the_unit_file_is_hardened() -> None:
    analyze = require("systemd-analyze", "systemd")
    done = subprocess.run(
        [analyze, "security", "--offline=yes", str(UNIT)], capture_output=True, text=True, check=False, timeout=60
    )
    exposure = re.search(r"Overall exposure level for beamtouch-daemon.service: ([0-9.]+) ", done.stdout)
    assert exposure is not None
    assert float(exposure[1]) <= 1.5
    text = UNIT.read_text()
    assert "WatchdogSec=30" in text
    assert {"Restart=always", "RestartPreventExitStatus=2", "StartLimitIntervalSec=0"} <= set(text.splitlines())
    # systemd finds the number of a name only if its driver is loaded when the unit starts.
    assert all(line.split("-")[1].split()[0].isdecimal() for line in text.splitlines() if "DeviceAllow=char-" in line)
    assert PATIENCE_S * 2 <= 30
