"""A damaged spool is replaced by a new one with every batch that can be read, and never before that is possible."""

import os
import sqlite3
import subprocess
import sys
import time
from contextlib import closing
from pathlib import Path

import pytest

from beamtouch_daemon.delivery.spool import BOOT_ID, Spool
from beamtouch_daemon.delivery.spool_connection import SpoolError
from beamtouch_daemon.delivery.spool_row import row_of
from toolchain import made_once, need, run

from .small_disks import small_disk
from .spools import ROOM, batch_of, drained

PAGE = 4096
SAMPLES = 50
"""In each batch, which then covers several pages."""


def filled(path: Path, rows: int) -> None:
    """Make a spool with many batches, in one transaction: the disk is waited for once."""
    with Spool(path, ROOM):
        boot = BOOT_ID.read_text().strip()
    with closing(sqlite3.connect(path)) as database, database:
        for number in range(rows):
            row = row_of("bench", batch_of(number * SAMPLES, SAMPLES), boot, time.monotonic())
            database.execute("INSERT INTO batch VALUES (?, ?, ?, ?, ?, ?, ?)", (number + 1, *row))


def test_damage_among_delivered_batches_costs_those_behind_them_nothing(tmp_path: Path) -> None:
    rows, delivered = 900, 600  # several MB: more than the cache of the database
    filled(tmp_path / "spool", rows)
    with Spool(tmp_path / "spool", ROOM) as spool:
        source = drained(spool)
        for _ in range(delivered):
            next(source)
        with (tmp_path / "spool").open("r+b") as file:
            file.seek(10 * PAGE)
            file.write(b"\x55" * 20 * PAGE)
        with pytest.raises(SpoolError, match="cannot write to the spool"):
            spool.sweep()
        assert [batch.samples[0].sequence // SAMPLES for batch in drained(spool)] == list(range(delivered, rows))
        assert spool.set_aside["bench"] == 0


ON_A_FULL_DISK = """
import logging, os, sys
from pathlib import Path
from beamtouch_daemon.delivery.spool import Spool
from beamtouch_daemon.delivery.spool_connection import SpoolError
logging.basicConfig(format="%(message)s")
path = Path(sys.argv[1])
def begin():
    spool = Spool(path / "spool", 10**7)
    print(spool.is_open, *(sorted(one.name for one in path.iterdir() if "reserve" not in one.name)))
    return spool
for _ in range(2):  # as after a restart
    with begin() as spool:
        pass
with begin() as spool:
    os.unlink(path / "filler")
    spool.open()
    after = found = 0
    while (one := spool.oldest("bench", after)) is not None:
        after, found = one.number, found + 1
    print(spool.is_open, found, spool.waiting["bench"], len(list(path.glob("spool.damaged-*[0-9]"))))
"""


def test_a_damaged_spool_on_a_full_disk_stays_until_there_is_room_to_rescue_it(tmp_path: Path) -> None:
    rows = 60
    filled(tmp_path / "damaged", rows)
    with (tmp_path / "damaged").open("r+b") as file:
        file.seek(30 * PAGE)
        file.write(b"\x55" * PAGE)
    with small_disk(tmp_path, size_kib=2048) as disk:
        disk.run("cp", str(tmp_path / "damaged"), str(disk.path / "spool"))
        disk.fill()
        *before, after = disk.run(sys.executable, "-c", ON_A_FULL_DISK, str(disk.path)).splitlines()
    assert before == ["False filler spool"] * 3
    is_open, found, waiting, aside = after.split()
    assert (is_open, aside) == ("True", "1")
    assert rows - 5 < int(found) < rows
    assert int(waiting) == SAMPLES * int(found)


WITH_A_BAD_SECTOR = """
import sys
from pathlib import Path
from beamtouch_daemon.delivery.spool import Spool
from beamtouch_daemon.delivery.spool_connection import SpoolError
path, switch = Path(sys.argv[1]), Path(sys.argv[2])
with Spool(path, 10**7) as spool:
    switch.touch()
    found, errors = [], 0
    while errors < 5:
        try:
            oldest = spool.oldest("bench")
        except SpoolError:
            errors += 1
            continue
        if oldest is None:
            break
        found.append(oldest.batch.samples[0].sequence)
        spool.remove("bench", oldest)
    print(errors, spool.set_aside["bench"], spool.waiting["bench"], *found)
"""


@pytest.mark.parametrize("is_bad_at_start", [False, True], ids=["in use", "at the start"])
def test_a_sector_that_cannot_be_read_costs_one_batch(
    tmp_path: Path, tmp_path_factory: pytest.TempPathFactory, *, is_bad_at_start: bool
) -> None:
    need("gcc")
    source = Path(__file__).with_name("bad_sector.c")
    folder = made_once(
        tmp_path_factory,
        "bad-sector",
        lambda made: run("gcc", "-shared", "-fPIC", "-o", made / "bad_sector.so", source, "-ldl"),
    )
    rows, bad = 900, 400  # several MB: more than the cache of the database
    path, switch = tmp_path / "spool", tmp_path / "is bad"
    filled(path, rows)
    if is_bad_at_start:
        switch.touch()
    disk = {
        "LD_PRELOAD": str(folder / "bad_sector.so"),
        "BAD_INODE": str(path.stat().st_ino),
        "BAD_OFFSET": str(path.read_bytes().index(b'"sequence":%d,' % (bad * SAMPLES + 20))),
        "BAD_SWITCH": str(switch),
    }
    command = [sys.executable, "-c", WITH_A_BAD_SECTOR, str(path), str(switch)]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=120, env=os.environ | disk)
    errors, set_aside, waiting, *found = map(int, done.stdout.split())
    assert found == [SAMPLES * number for number in range(rows) if number != bad]
    assert (set_aside, waiting) == (SAMPLES if not is_bad_at_start else 1, 0)
    assert errors == (0 if is_bad_at_start else 1)


HALF_CONVERTED = """
import os, shutil, sqlite3, sys
from contextlib import closing
from pathlib import Path
from beamtouch_daemon.delivery.spool import Spool
path, filler = Path(sys.argv[1]), Path(sys.argv[1]) / "filler"
size = filler.stat().st_size
for pages in range(int(sys.argv[2])):
    for one in path.glob("spool*"):
        one.unlink()
    os.truncate(filler, 0)
    shutil.copy(path / "old", path / "spool")
    with filler.open("ab", 0) as file:
        try:
            while file.write(bytes(4096)):
                pass
        except OSError:
            pass
        file.truncate(file.tell() - 4096 * pages)
    with Spool(path / "spool", 10**7) as spool:
        waiting = spool.waiting["bench"]
    with closing(sqlite3.connect(path / "spool")) as database:
        database.execute("PRAGMA locking_mode = EXCLUSIVE")  # needs no index of the log, which has no room
        columns = [name for _, name, *_ in database.execute("PRAGMA table_info(batch)")]
        tables = {name for name, in database.execute("SELECT name FROM sqlite_master")}
    print(waiting, "checksum" in columns, "aside" in tables, "entry" in tables)
"""


def test_a_spool_of_an_older_version_is_converted_wholly_or_not_at_all(tmp_path: Path) -> None:
    columns = "id INTEGER PRIMARY KEY, surface TEXT, samples INTEGER, machine_boot TEXT, newest_monotonic_s REAL"
    with closing(sqlite3.connect(tmp_path / "old")) as database, database:
        database.execute("PRAGMA journal_mode = WAL")
        database.execute(f"CREATE TABLE batch ({columns}, content TEXT)")
        database.execute("CREATE INDEX by_surface ON batch (surface, id)")
        for number in range(20):
            row = row_of("bench", batch_of(10 * number), BOOT_ID.read_text().strip(), time.monotonic())[:-1]
            database.execute("INSERT INTO batch VALUES (?, ?, ?, ?, ?, ?)", (number + 1, *row))
    with small_disk(tmp_path, size_kib=1024) as disk:
        disk.run("cp", str(tmp_path / "old"), str(disk.path / "old"))
        disk.fill()
        said = disk.run(sys.executable, "-c", HALF_CONVERTED, str(disk.path), "12").splitlines()
    assert set(said) == {"200 False False False", "200 True True True"}
