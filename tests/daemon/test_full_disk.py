"""A full disk under the spool, on the daemon as a process: what is kept, delivered and reported."""

import asyncio
import shutil
import sqlite3
import sys
from contextlib import closing
from pathlib import Path
from time import monotonic

import pytest

from beamtouch_daemon.delivery.spool import BOOT_ID, Spool
from beamtouch_daemon.delivery.spool_row import row_of

from . import configs
from .devices import SerialDevice, StampingUnit, tcp_unit
from .faulty import batches_in, cable, everything, names, running
from .process import free_port, summary_of
from .service import Service, serving
from .small_disks import small_disk
from .spools import batch_of

pytestmark = [pytest.mark.anyio, pytest.mark.long]


SMALL_DISK = "import resource, sys; resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))"


async def more_readings(device: SerialDevice, number: int) -> None:
    begun = device.sequence
    async with asyncio.timeout(60):
        while device.sequence < begun + number:  # noqa: ASYNC110 - the device is outside
            await asyncio.sleep(0.02)


async def test_on_a_full_disk_samples_stay_in_memory(tmp_path: Path) -> None:
    with cable(tmp_path) as usb:
        device = SerialDevice(usb.plug())
        port = free_port()
        url, source = f"http://127.0.0.1:{port}", configs.serial(str(usb.path))
        async with running(tmp_path, source, url, code=SMALL_DISK) as daemon:
            async with asyncio.timeout(60):
                while device.sequence < 2000:  # noqa: ASYNC110 - the device is outside
                    await asyncio.sleep(0.05)
            async with serving(Service(("127.0.0.1", port))) as service:
                await service.until(2000, within_s=60)
                outcome = await daemon.stop()
        assert outcome.code == 0
        assert outcome.err.count("cannot write to the spool") == 1
        counts = summary_of(tmp_path)["bench"]
        assert counts["samples_dropped"] == 0
        with Spool(tmp_path / "beamtouch-daemon.spool", 10**9) as spool:
            kept = names(batches_in(spool))
        arrived = names([batch for _, batch, _ in service.batches])
        assert len(set(arrived)) == len(arrived) == counts["samples_published"]
        assert len(set(arrived) | set(kept)) == counts["readings"]


async def test_a_disk_that_is_full_is_emptied_when_the_service_is_back_and_keeps_what_a_stop_leaves(
    tmp_path: Path,
) -> None:
    with small_disk(tmp_path, size_kib=2048) as disk, cable(tmp_path) as usb:
        device = SerialDevice(usb.plug())
        port = free_port()
        url, source = f"http://127.0.0.1:{port}", configs.serial(str(usb.path))
        publish = f'spool_file = "{disk.path}/spool"'
        async with running(tmp_path, source, url, publish=publish, prefix=disk.prefix) as daemon:
            await more_readings(device, 600)
            disk.fill()
            await more_readings(device, 400)
            async with serving(Service(("127.0.0.1", port))) as service:
                await service.until(1)
                await everything(service)
                assert len(service.samples()) > 1000
            disk.fill()
            await more_readings(device, 1200)
            outcome = await daemon.stop()
        assert outcome.code == 0
        assert "cannot write to the spool" in outcome.err
        before = summary_of(tmp_path)["bench"]
        assert before["samples_dropped"] == before["samples_set_aside"] == 0
        assert before["samples_spooled"] >= 1000
        assert before["samples_published"] + before["samples_spooled"] == before["readings"]
        # A start on a disk that is still full delivers them.
        async with (
            serving(Service(("127.0.0.1", port))) as service,
            running(tmp_path, source, url, publish=publish, prefix=disk.prefix) as daemon,
        ):
            await service.until(before["samples_spooled"] + 200)
            assert (await daemon.stop()).code == 0
        after = summary_of(tmp_path)["bench"]
        assert after["samples_spooled"] == after["samples_dropped"] == 0
        assert after["samples_published"] == after["readings"] + before["samples_spooled"]


async def test_the_loss_is_reported_if_the_disk_is_full_from_the_start_and_the_service_is_away(tmp_path: Path) -> None:
    with small_disk(tmp_path, size_kib=64) as disk:
        disk.fill()
        with cable(tmp_path) as usb:
            device = SerialDevice(usb.plug())
            url, source = f"http://127.0.0.1:{free_port()}", configs.serial(str(usb.path))
            publish = f'spool_file = "{disk.path}/spool"'
            async with running(tmp_path, source, url, publish=publish, prefix=disk.prefix) as daemon:
                await more_readings(device, 200)
                outcome = await daemon.stop()
            assert outcome.code == 0
            assert "the disk is full; until it can be, undelivered samples are kept in memory" in outcome.err
            counts = summary_of(tmp_path)["bench"]
            assert counts["samples_dropped"] == counts["readings"] > 100
            assert f"{counts['readings']} samples dropped: neither" in outcome.err


def old_spool(path: Path, batches: int) -> None:
    """Create a spool as older versions did, with a log and without checksums; and one that a killed daemon left."""
    boot = BOOT_ID.read_text().strip()
    columns = "id INTEGER PRIMARY KEY, surface TEXT, samples INTEGER, machine_boot TEXT, newest_monotonic_s REAL"
    with closing(sqlite3.connect(path)) as database:
        database.execute("PRAGMA journal_mode = WAL")
        database.execute(f"CREATE TABLE batch ({columns}, content TEXT)")
        for number in range(batches):
            row = row_of("bench", batch_of(10 * number), boot, monotonic())[:-1]
            database.execute("INSERT INTO batch VALUES (?, ?, ?, ?, ?, ?)", (number + 1, *row))
        database.commit()
        for tail in ("", "-wal"):
            shutil.copy(f"{path}{tail}", path.with_name(f"killed{tail}"))


async def test_a_spool_of_an_older_version_on_a_full_disk_is_delivered_at_once_and_then_replaced(
    tmp_path: Path,
) -> None:
    batches = 50
    old_spool(tmp_path / "old", batches)
    boot_id = batch_of(0).boot_id
    with small_disk(tmp_path, size_kib=1024) as disk:
        disk.run("cp", str(tmp_path / "old"), str(disk.path / "spool"))
        disk.fill()
        publish = f'spool_file = "{disk.path}/spool"'
        async with (
            tcp_unit(StampingUnit()) as port,
            serving(Service()) as service,
            running(tmp_path, configs.tcp(port), service.url, publish=publish, prefix=disk.prefix) as daemon,
        ):
            await service.until(50, within_s=60)
            async with asyncio.timeout(60):
                while sum(batch.boot_id == boot_id for _, batch, _ in service.batches) < batches:  # noqa: ASYNC110
                    await asyncio.sleep(0.05)
            outcome = await daemon.stop()
        assert outcome.code == 0
        assert "the disk is full; the older spool" in outcome.err
        assert (
            disk.run(sys.executable, "-c", ROWS, str(disk.path / "spool")) == "0 delete\n"
        )  # no write-ahead log any more


ROWS = """
import sqlite3, sys
database = sqlite3.connect(sys.argv[1])
print(*database.execute("SELECT count(*) FROM batch").fetchone(), *database.execute("PRAGMA journal_mode").fetchone())
"""

CONVERTED = """
import os, sys
from pathlib import Path
from beamtouch_daemon.delivery.spool import Spool
from beamtouch_daemon.delivery.spool_connection import SpoolError
sys.path.insert(0, {tests!r})
from daemon.spools import batch_of
path = Path({path!r})
with Spool(path / "spool", 10**7) as spool:
    for _ in range(10):
        spool.remove("bench", spool.oldest("bench"))
    for doing in (spool.sweep, lambda: spool.put("bench", batch_of(500), 0.0)):
        try:
            doing()
            print("not full")
        except SpoolError:
            pass
    print(spool.unremoved, spool.waiting["bench"])
    os.unlink(path / "filler")
    spool.put("bench", batch_of(500), 0.0)
    print(spool.sweep(), spool.unremoved, spool.waiting["bench"])
with Spool(path / "spool", 10**7) as spool:
    after, firsts = 0, []
    while (one := spool.oldest("bench", after)) is not None:
        after = one.number
        firsts.append(one.batch.samples[0].sequence)
    print(*firsts)
"""


@pytest.mark.parametrize("tails", [{"old": ""}, {"killed": "", "killed-wal": "-wal"}], ids=["stopped", "killed"])
def test_a_spool_of_an_older_version_is_converted_once_the_disk_has_room(tmp_path: Path, tails: dict[str, str]) -> None:
    old_spool(tmp_path / "old", 50)
    with small_disk(tmp_path, size_kib=1024) as disk:
        for name, tail in tails.items():
            disk.run("cp", str(tmp_path / name), str(disk.path / f"spool{tail}"))
        disk.fill()
        code = CONVERTED.format(tests=str(Path(__file__).parents[1]), path=str(disk.path))
        said = disk.run(sys.executable, "-c", code).splitlines()
        assert said == ["10 400", "10 0 410", " ".join(map(str, range(100, 510, 10)))]
        assert disk.run(sys.executable, "-c", ROWS, str(disk.path / "spool")) == "41 delete\n"
