"""Tasks of the daemon: which count as hanging, how they are cancelled, and what restarts them."""

import asyncio
from collections.abc import Callable
from contextlib import suppress
from types import SimpleNamespace
from typing import cast

import pytest

from beamtouch_daemon.config.sources import ModbusRtu
from beamtouch_daemon.running.acquisition import PATIENCE_S, Acquisition
from beamtouch_daemon.sources.rtu_bus import REST_TIMEOUTS
from beamtouch_daemon.tasks import RESTART_S, cancel, keep_going


def test_a_line_without_progress_hangs_and_one_without_a_device_does_not() -> None:
    def line(turned_s: float, rate_hz: float = 100.0, timeout_ms: float = 1.0) -> Acquisition:
        source = ModbusRtu(kind="modbus-rtu", port="/dev/ttyUSB0", timeout_ms=timeout_ms)
        found = SimpleNamespace(surface=SimpleNamespace(rate_hz=rate_hz, source=source), turned_s=turned_s)
        return cast("Acquisition", found)

    now_s, long_ago_s = 1000.0, 1000.0 - PATIENCE_S - 1
    hangs: Callable[[Acquisition, float], bool] = Acquisition.hangs
    assert not hangs(line(now_s), now_s)
    assert hangs(line(long_ago_s), now_s)  # reading stands still
    assert PATIENCE_S * 2 <= 30  # before the watchdog of the unit
    assert not hangs(line(long_ago_s, rate_hz=0.1), now_s)  # it reads that seldom
    rested_s = now_s - (REST_TIMEOUTS + 1) * 4.0
    assert not hangs(line(rested_s, timeout_ms=4000.0), now_s)  # a unit that is off is asked that seldom


@pytest.mark.anyio
async def test_a_task_is_cancelled_though_it_swallows_a_cancellation_and_restarted_after_an_unexpected_error(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    async def swallow_one() -> None:
        with suppress(asyncio.CancelledError):
            await asyncio.sleep(60)
        await asyncio.sleep(60)

    task = asyncio.create_task(swallow_one())
    await asyncio.sleep(0)
    await asyncio.wait_for(cancel({task}), 30)
    assert task.cancelled()
    turns = 0

    async def work() -> None:
        nonlocal turns
        turns += 1
        if turns == 1:
            raise ValueError("unexpected")

    assert RESTART_S > 1
    monkeypatch.setattr("beamtouch_daemon.tasks.RESTART_S", 0.0)
    await keep_going("bench", work)
    assert turns == 2
    assert "bench: unexpected error; restarting" in caplog.text
