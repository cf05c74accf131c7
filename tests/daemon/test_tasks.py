"""Tasks of the daemon: how they are cancelled, and what restarts them."""

import asyncio
from contextlib import suppress

import pytest

from beamtouch_daemon.tasks import RESTART_S, cancel, keep_going


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
