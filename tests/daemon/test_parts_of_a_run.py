"""Parts of a running daemon: its log file, surfaces that only the log knows, and the last work before it ends."""

import asyncio
import logging
from pathlib import Path

import pytest

from beamtouch_common.errors import InputError
from beamtouch_common.parts import Parts
from beamtouch_daemon.config.settings import Config
from beamtouch_daemon.delivery.client import ServiceClient
from beamtouch_daemon.delivery.log_file import Chunk
from beamtouch_daemon.delivery.log_store import LogStore
from beamtouch_daemon.running import daemon
from beamtouch_daemon.tasks import cancel

from .publishing import boot, stored, taken
from .record import Record
from .service import TOKEN, Service, serving
from .surfaces import surface_of
from .waits import until

pytestmark = pytest.mark.anyio

NOWHERE = "http://127.0.0.1:1"
LOG = "beamtouch-daemon.samples"


def config_of(folder: Path, **publish: object) -> Config:
    context = {"directory": folder, "files": {"bench": folder / "daemon.toml"}}
    content = {"publish": {"url": NOWHERE, "token_file": "token"} | publish, "surfaces": {"bench": surface_of()}}
    return Config.model_validate(content, context=context)


async def test_a_log_file_that_is_another_file_is_wrong_input_and_stays(tmp_path: Path) -> None:
    (tmp_path / LOG).write_text("this is no log" * 100)
    with pytest.raises(InputError) as raised:
        async with daemon._opened_store(config_of(tmp_path)):
            pass
    assert str(raised.value) == f"publish.log_file: {tmp_path / LOG} is not a log; choose another file"
    assert (tmp_path / LOG).read_text() == "this is no log" * 100


@pytest.mark.parametrize(("log_mb", "most"), [(200.0, 200_000_000), (0.0000015, 2)])
async def test_a_log_file_is_limited_in_megabytes(tmp_path: Path, log_mb: float, most: int) -> None:
    async with daemon._opened_store(config_of(tmp_path, log_mb=log_mb)) as store:
        assert store._file is not None
        assert (store._file._max_bytes, store._file.is_open) == (most, True)
    assert not store._file.is_open


async def test_without_megabytes_there_is_no_log_file(tmp_path: Path) -> None:
    async with daemon._opened_store(config_of(tmp_path, log_mb=0.0)) as store:
        assert store._file is None
    assert not (tmp_path / LOG).exists()


async def test_a_surface_of_which_only_the_log_knows_is_named_and_delivered(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("INFO", "beamtouch_daemon.running")
    async with serving(Service(record=Record())) as service, ServiceClient(service.url, TOKEN) as client:
        store = LogStore(None, 0)
        for name in ("bench", "gone"):
            store.surface(name).adopt(Chunk(1, 3, 9), boot("boot-0000"))
        parts = Parts(logging.getLogger(__name__))
        delivering = asyncio.ensure_future(daemon._deliver_backlogs(config_of(tmp_path), client, store, parts))
        await until(lambda: len(parts.failures) == 2)
        await cancel([delivering])
    assert set(parts.failures) == {"bench backlog", "gone backlog"}
    # On a slow machine the log file that is not there is told as well.
    told = [one for one in caplog.messages if "not configured" in one]
    assert told == ["gone: not configured; the samples in its log are delivered"]


async def test_at_the_end_what_the_service_does_not_take_is_in_the_log_file(tmp_path: Path) -> None:
    async with stored(tmp_path / LOG) as store, ServiceClient(NOWHERE, TOKEN) as client:
        logs = store.surface("bench")
        logs.begin(boot(), 100).put(taken(1, 5))
        await daemon._finish(client, store)
        assert (logs.on_disk, logs.in_memory) == (5, 0)


async def test_at_the_end_what_is_left_is_delivered(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(daemon, "FINISH_S", 60.0)
    async with serving(Service(record=Record())) as service, ServiceClient(service.url, TOKEN) as client:
        store = LogStore(None, 0)
        logs = store.surface("bench")
        logs.begin(boot(), 100).put(taken(1, 5))
        await daemon._finish(client, store)
    assert logs.counts.published == 5
    assert service.record.numbers() == {"boot-0001": [1, 2, 3, 4, 5]}


async def test_an_error_in_a_last_piece_of_work_is_said_and_stops_no_other(caplog: pytest.LogCaptureFixture) -> None:
    with daemon._reported("zeros"):
        raise ValueError("broken")
    (record,) = caplog.records
    assert (record.levelname, record.getMessage()) == ("CRITICAL", "zeros: unexpected error while stopping")
    assert record.exc_info
