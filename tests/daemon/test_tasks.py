"""Tasks of the daemon: how they are cancelled."""

import asyncio
from contextlib import suppress

import pytest

from beamtouch_daemon.tasks import cancel


@pytest.mark.anyio
async def test_a_task_is_cancelled_though_it_swallows_a_cancellation() -> None:
    async def swallow_one() -> None:
        with suppress(asyncio.CancelledError):
            await asyncio.sleep(60)
        await asyncio.sleep(60)

    task = asyncio.create_task(swallow_one())
    await asyncio.sleep(0)
    await asyncio.wait_for(cancel({task}), 30)
    assert task.cancelled()
