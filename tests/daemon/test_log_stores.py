"""What a log writes to its file and when, and a file that can be opened only later."""

import asyncio
from pathlib import Path

import pytest

from beamtouch_daemon.delivery import log_store
from beamtouch_daemon.delivery.log_store import LogStore
from beamtouch_daemon.tasks import cancel

from .publishing import ROOM, boot, stored, taken
from .waits import until

pytestmark = pytest.mark.anyio


async def test_a_file_that_cannot_be_opened_is_said_once_and_opened_once_that_is_possible(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("INFO")
    path = tmp_path / "gone" / "samples"
    store = LogStore(path, ROOM)
    logs = store.surface("bench")
    logs.begin(boot(), 100).put(taken(1, 5))
    for _ in range(2):
        await store.open()
        await store.write(None)
    assert (logs.on_disk, logs.in_memory) == (0, 5)
    path.parent.mkdir()
    await store.open()
    first, again = caplog.messages
    said = f"log file: {path} cannot be opened (unable to open database file); samples stay in memory, trying again"
    assert first == said
    assert again.startswith("log file: works again after ")
    await store.write(None)
    assert (logs.on_disk, logs.in_memory) == (5, 0)
    await store.close()


async def test_old_samples_that_live_batches_have_taken_go_to_the_file_and_at_a_stop_all(tmp_path: Path) -> None:
    async with stored(tmp_path / "samples") as store:
        logs = store.surface("bench")
        one = logs.begin(boot(), 100)
        one.put([*taken(1, 4, age_s=9.0), *taken(5, 2)])
        await store.write(5.0)
        assert (logs.on_disk, logs.in_memory) == (0, 6)  # a live batch may bring them
        one.live.begin(1, 3)
        one.live.end(1)
        await store.write(60.0)
        assert logs.on_disk == 0
        await store.write(5.0)
        assert (logs.on_disk, logs.in_memory) == (3, 3)
        await store.write(None)
        assert (logs.on_disk, logs.in_memory) == (6, 0)


async def test_what_is_old_is_written_once_a_second_while_the_daemon_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with stored(tmp_path / "samples") as store:
        logs = store.surface("bench")
        one = logs.begin(boot(), 100)
        one.put(taken(1, 4, age_s=9.0))
        one.live.begin(1, 4)
        one.live.end(1)
        running = asyncio.ensure_future(store.run())
        await asyncio.sleep(0.02)
        await cancel([running])
        assert logs.on_disk == 0
        monkeypatch.setattr(log_store, "WRITE_S", 0.001)
        running = asyncio.ensure_future(store.run())
        await until(lambda: logs.on_disk == 4)
        one.put(taken(5, 1))
        one.live.begin(5, 5)
        one.live.end(5)
        await asyncio.sleep(0.02)
        await cancel([running])
        assert (logs.on_disk, logs.in_memory) == (4, 1)  # it is new
