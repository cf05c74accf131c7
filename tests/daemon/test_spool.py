"""The spool on disk: in order, bounded, and whole after a crash at any moment."""

import os
import resource
import signal
import sqlite3
import subprocess
import sys
import time
from contextlib import closing
from pathlib import Path

import pytest

from beamtouch_daemon.delivery.spool import Spool
from beamtouch_daemon.delivery.spool_connection import SpoolError
from beamtouch_daemon.delivery.spool_row import MARGIN_S

from .spools import ROOM, batch_of, drained


def test_batches_come_back_in_order_by_surface_and_over_a_restart(tmp_path: Path) -> None:
    pressed = batch_of(7)
    with Spool(tmp_path / "spool", ROOM) as spool:
        for first in (0, 10, 20):
            spool.put("bench", batch_of(first), time.monotonic())
        spool.put("press", pressed, time.monotonic())
        assert spool.waiting == {"bench": 30, "press": 10}
    with Spool(tmp_path / "spool", ROOM) as spool:
        assert spool.waiting == {"bench": 30, "press": 10}
        assert [batch.samples[0].sequence for batch in drained(spool)] == [0, 10, 20]
        assert spool.oldest("bench") is None
        assert spool.waiting["bench"] == 0
        (other,) = drained(spool, "press")
        assert other.samples == pressed.samples


def test_the_database_of_another_program_stays_as_it_is(tmp_path: Path) -> None:
    path = tmp_path / "orders.db"
    with closing(sqlite3.connect(path)) as database, database:
        database.execute("CREATE TABLE orders (surface)")
        database.execute("CREATE INDEX by_surface ON orders (surface)")  # as in the service's file of events
    content = path.read_bytes()
    with pytest.raises(SpoolError, match=r"orders\.db cannot be opened \(it is the database of another program\)"):
        Spool(path, ROOM)
    assert path.read_bytes() == content
    assert list(tmp_path.iterdir()) == [path]


def test_a_batch_comes_back_with_the_time_of_its_newest_sample(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with Spool(tmp_path / "spool", ROOM) as spool:
        written_s = time.monotonic()
        spool.put("bench", batch_of(0), written_s - 5)
        oldest = spool.oldest("bench")
        assert oldest is not None
        assert oldest.newest_s == written_s - 5
    (tmp_path / "another_boot").write_text("another\n")
    monkeypatch.setattr("beamtouch_daemon.delivery.spool.BOOT_ID", tmp_path / "another_boot")
    with Spool(tmp_path / "spool", ROOM) as spool:
        oldest = spool.oldest("bench")
        assert oldest is not None
        assert oldest.newest_s < -MARGIN_S + 1  # before this boot by the margin, whatever the clocks say


def test_beyond_its_size_the_oldest_are_dropped_and_counted(tmp_path: Path) -> None:
    length = len(batch_of(0).model_dump_json(exclude_defaults=True))
    with Spool(tmp_path / "spool", round(4.5 * length)) as spool:
        spool.put("press", batch_of(0), 0.0)
        for first in range(0, 100, 10):
            spool.put("bench", batch_of(first), 0.0)
        assert spool.dropped == {"press": 10, "bench": 60}
        assert spool.waiting["bench"] == 40
        assert [batch.samples[0].sequence for batch in drained(spool)] == [60, 70, 80, 90]
    assert (tmp_path / "spool").stat().st_size < 20 * length + 50_000


def test_one_process_at_a_time_uses_it(tmp_path: Path) -> None:
    with Spool(tmp_path / "spool", ROOM) as spool:
        spool.put("bench", batch_of(0), 0.0)
        code = "import pathlib, sys\nfrom beamtouch_daemon.delivery.spool import Spool\n"
        code += "Spool(pathlib.Path(sys.argv[1]), 9)"
        command = [sys.executable, "-c", code, str(tmp_path / "spool")]
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
        assert "is in use by another process" in done.stderr.splitlines()[-1]


def test_a_damaged_file_is_put_aside_and_not_lost(tmp_path: Path) -> None:
    (tmp_path / "spool").write_bytes(b"this is no database, however long it may be" * 100)
    with Spool(tmp_path / "spool", ROOM) as spool:
        spool.put("bench", batch_of(0), 0.0)
    (aside,) = tmp_path.glob("spool.damaged-*")
    assert aside.read_bytes().startswith(b"this is no database")


def test_a_missing_folder_is_an_error_in_one_line_until_it_comes(tmp_path: Path) -> None:
    with Spool(tmp_path / "absent" / "spool", ROOM) as spool:
        with pytest.raises(SpoolError, match="cannot be opened"):
            spool.open()
        (tmp_path / "absent").mkdir()
        spool.open()
        assert spool.is_open


FULL_DISK = """
import resource, sys, time
from pathlib import Path
from beamtouch_daemon.delivery.spool import Spool
from beamtouch_daemon.delivery.spool_connection import SpoolError
from beamtouch_daemon.delivery.spool_row import MARGIN_S
sys.path.insert(0, {tests!r})
from daemon.spools import batch_of
with Spool(Path({path!r}), 10**9) as spool:
    spool.put("bench", batch_of(0), 0.0)
    resource.setrlimit(resource.RLIMIT_FSIZE, ({most}, {most}))
    stored = 1
    try:
        for _ in range(1000):
            spool.put("bench", batch_of(10 * stored), 0.0)
            stored += 1
    except SpoolError as error:
        print(stored, spool.waiting["bench"], error)
    resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
"""


def test_a_full_disk_is_an_error_that_changes_nothing(tmp_path: Path) -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    assert soft == hard == resource.RLIM_INFINITY  # else the process below cannot lift its own limit again
    tests = str(Path(__file__).parents[1])
    code = FULL_DISK.format(tests=tests, path=str(tmp_path / "spool"), most=200_000)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=60)
    stored, waiting, words = done.stdout.split(maxsplit=2)
    assert words.startswith("cannot write to the spool: ")
    assert int(waiting) == 10 * int(stored) > 100
    with Spool(tmp_path / "spool", ROOM) as spool:
        assert [batch.samples[0].sequence for batch in drained(spool)] == list(range(0, int(waiting), 10))


KILLED = """
import sys, time
from pathlib import Path
from beamtouch_daemon.delivery.spool import Spool
sys.path.insert(0, {tests!r})
from daemon.spools import batch_of
with Spool(Path({path!r}), 10**9) as spool:
    first = {first}
    while True:
        spool.put("bench", batch_of(first), 0.0)
        first += 10
        print(first, flush=True)
"""


def test_killed_twenty_times_nothing_that_was_put_is_lost(tmp_path: Path) -> None:
    tests, known = str(Path(__file__).parents[1]), 0
    for turn in range(20):
        code = KILLED.format(tests=tests, path=str(tmp_path / "spool"), first=known)
        with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as process:
            assert process.stdout is not None
            for _ in range(2 + turn):  # at another moment each time
                line = process.stdout.readline()
                assert line
            os.kill(process.pid, signal.SIGKILL)
            said = [int(rest) for rest in (line + process.stdout.read()).split() if rest.isdecimal()]
        with Spool(tmp_path / "spool", ROOM) as spool:
            # One more may have reached the disk than could be said.
            assert said[-1] <= spool.waiting["bench"] <= said[-1] + 10
            known = spool.waiting["bench"]
    with Spool(tmp_path / "spool", ROOM) as spool:
        sequences = [sample.sequence for batch in drained(spool) for sample in batch.samples]
    assert sequences == list(range(known))
