"""Counts of samples that wait in memory."""

import asyncio
from pathlib import Path

import pytest

from beamtouch_daemon.config.file import load_config
from beamtouch_daemon.delivery.client import ServiceClient
from beamtouch_daemon.running import surface_worker
from beamtouch_daemon.running.surface_worker import Shared, SurfaceWorker

from . import configs
from .process import free_port
from .publishing import taken

pytestmark = pytest.mark.anyio


async def test_samples_in_memory_count_as_dropped_only_once_they_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # The metrics read the counts in a thread of their own. So none may be the difference of two that change meanwhile.
    monkeypatch.setattr(surface_worker, "DRAIN_S", 0.1)
    config = load_config(configs.write(tmp_path, configs.surface(), url=f"http://127.0.0.1:{free_port()}"))
    async with ServiceClient(config.publish.url, "") as client, asyncio.TaskGroup() as group:
        worker = SurfaceWorker("bench", config.surfaces["bench"], {}, Shared(client, config.publish, {}, None))
        worker.outbox.put(taken(0, 10))
        assert worker.summary().samples_dropped == 0
        worker.start(group)
        await worker.stop()
        assert len(worker.outbox) == 0
        assert worker.summary().samples_dropped == 10
