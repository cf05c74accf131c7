"""Outages, crashes, full disks and a stepped clock, on the daemon as a process: nothing taken is lost or doubled."""

import re
import signal
import sqlite3
import sys
from contextlib import closing, suppress
from itertools import pairwise
from pathlib import Path

import pytest

from beamtouch_service.samples import Quality
from support.network.free_ports import free_port
from support.running.debian_parts import require
from support.surfaces import configs

from .devices import SerialDevice
from .faulty import (
    LOG_FILE,
    batches_in,
    cable,
    counts_of,
    everything,
    leave_samples,
    names,
    running,
    samples_in,
)
from .process import summary_of
from .service import Service, serving
from .small_disks import small_disk
from .waits import until

pytestmark = [pytest.mark.anyio, pytest.mark.long]

OFTEN = "from beamtouch_daemon.delivery import log_store; log_store.MEMORY_S = log_store.WRITE_S = 0.1"
"""Code after which the log is written to its file ten times a second."""


@pytest.mark.parametrize("times", [3, pytest.param(20, marks=pytest.mark.soak)])
async def test_killed_again_and_again_all_that_was_written_arrives(tmp_path: Path, times: int) -> None:
    with cable(tmp_path) as usb:
        device = SerialDevice(usb.plug())
        port, written = free_port(), set[tuple[str, int]]()
        url, source = f"http://127.0.0.1:{port}", configs.serial(str(usb.path))
        turn = 0
        while turn < times:
            begun = device.sequence
            async with running(tmp_path, source, url, OFTEN) as daemon:
                enough = begun + 100 + 80 * turn / times
                await until(lambda enough=enough: device.sequence >= enough)  # type: ignore[misc]
                daemon.tell(signal.SIGKILL)
                with suppress(ProcessLookupError):
                    await daemon.end()
            device.stop()
            now = set(names(batches_in(tmp_path / LOG_FILE)))
            assert now >= written  # nothing that was there is gone
            turn += now > written  # a starved daemon has not always written something
            written = now
        async with serving(Service(("127.0.0.1", port))) as service, running(tmp_path, source, url) as daemon:
            await until(lambda: written <= recorded(service))
            assert (await daemon.stop()).code == 0
        assert all(numbers == list(range(1, len(numbers) + 1)) for numbers in service.record.numbers().values())
        assert not any(service.record.lost.values())
        assert all(second == first + 1000 for first, second in counts_of(service.samples()))


def recorded(service: Service) -> set[tuple[str, int]]:
    return {(boot, number) for boot, numbers in service.record.numbers().items() for number in numbers}


@pytest.mark.promise("docs/explanation/readings-to-samples.md", "over restarts too")
async def test_the_log_of_a_removed_surface_is_delivered_once_its_file_is_free(tmp_path: Path) -> None:
    with cable(tmp_path) as usb:
        device, source = SerialDevice(usb.plug()), configs.serial(str(usb.path))
        config = configs.write(tmp_path, configs.surface("press", source), url=f"http://127.0.0.1:{free_port()}")
        left = (await leave_samples(tmp_path, config, lambda: device.sequence >= 300))["samples_in_log"]
        (boot_id,) = {batch.boot_id for batch in batches_in(tmp_path / LOG_FILE)}
        with closing(sqlite3.connect(tmp_path / LOG_FILE)) as other:
            other.execute("BEGIN EXCLUSIVE")
            async with serving(Service()) as service, running(tmp_path, source, service.url) as daemon:
                await service.until(50)
                other.rollback()
                await service.until(left, "press")
                await everything(service)
                assert (await daemon.stop()).code == 0
    assert service.record.numbers("press") == {boot_id: list(range(1, left + 1))}
    counts = summary_of(tmp_path)["press"]
    assert counts.pop("samples_published") == left > 0
    assert set(counts.values()) == {0}
    assert samples_in(tmp_path / LOG_FILE) == []


async def test_samples_are_on_the_disk_before_the_log_file_counts_on_it(tmp_path: Path) -> None:
    trace = tmp_path / "trace"
    calls = "trace=pwrite64,fsync,fdatasync"
    # With -D the daemon is the child, and strace a process beside it.
    prefix = (require("strace", "strace"), "-D", "-f", "-qq", "-y", "-e", calls, "-o", str(trace))
    url = f"http://127.0.0.1:{free_port()}"
    with cable(tmp_path) as usb:
        device = SerialDevice(usb.plug())
        async with running(tmp_path, configs.serial(str(usb.path)), url, OFTEN, prefix=prefix) as daemon:
            await until(lambda: device.sequence >= 500)
            assert (await daemon.stop()).code == 0
    assert len(samples_in(tmp_path / LOG_FILE)) > 100
    unsynced, commits = set[str](), 0
    for call, name, rest in re.findall(r"(\w+)\(\d+<[^>]*/([^/>]+)>(.*)", trace.read_text()):
        if call != "pwrite64":
            commits += name == LOG_FILE and name in unsynced
            unsynced.discard(name)
        elif name == LOG_FILE:
            assert f"{name}-journal" not in unsynced  # what a crash now leaves half-written can be undone
            unsynced.add(name)
        elif name == f"{LOG_FILE}-journal":
            # The journal counts its pages only once they are on the disk.
            assert not (rest.endswith(", 12, 0) = 12") and name in unsynced)
            unsynced.add(name)
    assert commits >= 2
    assert LOG_FILE not in unsynced


def stepped_clock(sign: Path) -> str:
    """Return code after which the clock is an hour ahead as soon as a file is there."""
    return (
        "import os, time; real = time.time; "
        f"time.time = lambda: real() + (3600.0 if os.path.exists({str(sign)!r}) else 0.0)"
    )


async def test_a_clock_stepped_by_an_hour_changes_dates_and_nothing_else(tmp_path: Path) -> None:
    sign = tmp_path / "an hour later"
    with cable(tmp_path) as usb:
        SerialDevice(usb.plug())
        source = configs.serial(str(usb.path))
        async with (
            serving(Service()) as service,
            running(tmp_path, source, service.url, stepped_clock(sign)) as daemon,
        ):
            await service.until(100)
            sign.touch()
            await until(lambda: service.samples()[-1].acquired_unix_us - service.samples()[0].acquired_unix_us > 3.6e9)
            await service.until(len(service.samples()) + 100)
            await everything(service)
            assert (await daemon.stop()).code == 0
    # As recorded: on a starved machine, the newest arrive before older ones, and some twice.
    (numbers,) = service.record.numbers().values()
    samples = service.record.whole()
    assert numbers == list(range(1, len(samples) + 1))
    assert not any(service.record.lost.values())
    assert {quality for sample in samples for quality in sample.quality} == {Quality.GOOD}
    assert all((batch.newest_age_ms or 0.0) < 60_000 for _, batch, _ in service.batches)
    dates = [sample.acquired_unix_us for sample in samples]
    assert sum(later - earlier > 3.5e9 for earlier, later in pairwise(dates)) == 1


async def more_readings(device: SerialDevice, number: int) -> None:
    enough = device.sequence + number
    await until(lambda: device.sequence >= enough)


async def test_a_disk_that_is_full_is_emptied_when_the_service_is_back_and_keeps_what_a_stop_leaves(
    tmp_path: Path,
) -> None:
    with small_disk(tmp_path, size_kib=512) as disk, cable(tmp_path) as usb:
        device = SerialDevice(usb.plug())
        port = free_port()
        url, source = f"http://127.0.0.1:{port}", configs.serial(str(usb.path))
        publish = f'log_file = "{disk.path}/samples"'
        async with running(tmp_path, source, url, OFTEN, publish=publish, prefix=disk.prefix) as daemon:
            await more_readings(device, 600)
            disk.fill()
            await more_readings(device, 300)
            async with serving(Service(("127.0.0.1", port))) as service:
                await service.until(1)
                await until(lambda: len(service.record.whole()) > 800 - device.unsent)
                await everything(service)
            disk.fill()
            await more_readings(device, 250)  # what has room in the pages that the file kept
            outcome = await daemon.stop()
        assert outcome.code == 0
        before = summary_of(tmp_path)["bench"]
        assert before["samples_dropped"] == 0, outcome.err
        # A starved daemon has not read all that waits in the line, which holds some 200 readings.
        assert before["samples_in_log"] >= 100 - device.unsent
        assert before["samples_published"] + before["samples_in_log"] == before["readings"]
        # A start on a disk that is still full delivers them.
        async with (
            serving(Service(("127.0.0.1", port))) as service,
            running(tmp_path, source, url, publish=publish, prefix=disk.prefix) as daemon,
        ):
            await service.until(before["samples_in_log"] + 100)
            await everything(service)
            assert (await daemon.stop()).code == 0
        after = summary_of(tmp_path)["bench"]
        assert after["samples_in_log"] == after["samples_dropped"] == 0
        # A chunk, of at most 250 samples, stays whole until all of it is durable: a part may be found durable twice.
        again = after["samples_published"] - after["readings"] - before["samples_in_log"]
        assert 0 <= again < 250


MANY = """
import sys
from pathlib import Path
from beamtouch_daemon.delivery.log_file import LogFile
from beamtouch_service.samples import Batch

file = LogFile(Path(sys.argv[1]), 10**9)
file.open()
sample = {"sequence": 1, "acquired_unix_us": 1, "deflection_mm": [0.5] * 64, "quality": ["good"] * 64}
channels = [f"s{number}" for number in range(64)]
batch = Batch(boot_id="boot-0001", channels=channels, samples=[sample], backlog=True)
file.change([("bench", batch)] * 1000 if sys.argv[2] == "write" else [], set())
print(len(file.rows))
"""
"""Writes 1000 chunks into a file of logs, or deletes all that it has."""


def test_however_many_samples_become_durable_at_once_a_full_disk_lets_them_go(tmp_path: Path) -> None:
    """The journal of a deletion has no room for all of them together."""
    with small_disk(tmp_path, size_kib=4096) as disk:
        command = (sys.executable, "-c", MANY, str(disk.path / "samples"))
        assert disk.run(*command, "write") == "1000\n"
        disk.fill()
        assert disk.run(*command, "delete") == "0\n"
