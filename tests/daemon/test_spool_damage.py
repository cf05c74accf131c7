"""A spool that is damaged, in one row or in its structure: the rest is delivered, and the damaged part is kept."""

import sqlite3
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import pytest

from beamtouch_daemon.delivery.spool import BOOT_ID, Spool
from beamtouch_daemon.delivery.spool_connection import SpoolError
from beamtouch_daemon.delivery.spool_row import row_of

from .spools import ROOM, batch_of, drained

PAGE = 4096


def fill(path: Path, rows: int, samples: int) -> None:
    """Make a spool with many batches, in one transaction: the disk is waited for once."""
    with Spool(path, ROOM):
        boot = BOOT_ID.read_text().strip()
    with closing(sqlite3.connect(path)) as database, database:
        for number in range(rows):
            row = row_of("bench", batch_of(number * samples, samples), boot, time.monotonic())
            database.execute("INSERT INTO batch VALUES (?, ?, ?, ?, ?, ?, ?)", (number + 1, *row))


def flipped(content: str, place: int) -> bytes:
    """Return the content with one bit changed."""
    damaged = bytearray(content.encode())
    damaged[place] ^= 0x04
    return bytes(damaged)


DAMAGE: dict[str, Callable[[str], tuple[str, object]]] = {
    "no JSON": lambda content: ("content", flipped(content, 0).decode(errors="replace")),
    "another number": lambda content: ("content", content.replace("0.25", "0.65", 1)),
    "no text": lambda content: ("content", content.encode()[:40] + b"\xff" + content.encode()[41:]),
    "another schema": lambda _: ("content", '{"schema": 7}'),
    "a blob": lambda content: ("content", sqlite3.Binary(flipped(content, 30))),
    "another count": lambda _: ("samples", 10 + 2**40),
    "a count that is text": lambda _: ("samples", "ten"),
    "another time": lambda _: ("newest_monotonic_s", 1e300),
    "a time that is text": lambda _: ("newest_monotonic_s", "noon"),
    "another boot": lambda _: ("machine_boot", b"\xf0\xf1"),
    "no name": lambda _: ("surface", b"be\xffch"),
    "another name": lambda _: ("surface", "bencj"),
}


@pytest.mark.parametrize("damage", DAMAGE.values(), ids=DAMAGE.keys())
def test_a_row_that_changed_on_the_disk_is_set_aside_and_those_behind_it_come(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, damage: Callable[[str], tuple[str, object]]
) -> None:
    with Spool(tmp_path / "spool", ROOM) as spool:
        for first in (0, 10, 20):
            spool.put("bench", batch_of(first), time.monotonic())
    with closing(sqlite3.connect(tmp_path / "spool")) as database, database:
        (content,) = database.execute("SELECT content FROM batch WHERE id = 2").fetchone()
        column, value = damage(content)
        database.execute(f"UPDATE batch SET {column} = ? WHERE id = 2", (value,))  # noqa: S608
    for _ in range(2):  # a bad row is met once, and not again after a restart
        with Spool(tmp_path / "spool", ROOM) as spool:
            found = [first for name in ("bench", "bencj") for first in first_sequences(spool, name)]
            assert found == [0, 20]
            assert all(samples == 0 for samples in spool.waiting.values())
    assert sum("set aside" in record.getMessage() for record in caplog.records) == 1
    with closing(sqlite3.connect(tmp_path / "spool")) as database:
        assert database.execute("SELECT count(*) FROM batch JOIN aside USING (id)").fetchone() == (1,)


def first_sequences(spool: Spool, surface: str) -> list[int]:
    """Return where each batch of a surface begins, without taking them out."""
    found, after = list[int](), 0
    while (one := spool.oldest(surface, after)) is not None:
        found.append(one.batch.samples[0].sequence)
        after = one.number
    if surface == "bench" and len(found) == 2:
        spool.waiting["bench"] -= 20  # what is good still waits; the test asks for the rest
    return found


def test_samples_that_are_set_aside_are_counted_and_bounded(tmp_path: Path) -> None:
    length = len(batch_of(0).model_dump_json(exclude_defaults=True))
    with Spool(tmp_path / "spool", 35 * length) as spool:
        for first in range(0, 100, 10):
            number = spool.put("bench", batch_of(first), 0.0)
            if first < 80:
                spool.keep_aside("bench", number, "a test")
        assert spool.set_aside["bench"] == 80
        assert spool.waiting["bench"] == 20
        assert [batch.samples[0].sequence for batch in drained(spool)] == [80, 90]
    with closing(sqlite3.connect(tmp_path / "spool")) as database:
        assert database.execute("SELECT id, reason FROM aside").fetchall() == [(n, "a test") for n in (6, 7, 8)]


def test_pages_that_are_damaged_cost_the_rows_in_them_and_no_others(tmp_path: Path) -> None:
    rows = 300
    fill(tmp_path / "spool", rows, 10)
    content = bytearray((tmp_path / "spool").read_bytes())
    place = len(content) // PAGE // 2 * PAGE
    content[place : place + 2 * PAGE] = bytes(2 * PAGE)
    (tmp_path / "spool").write_bytes(content)
    with Spool(tmp_path / "spool", ROOM) as spool:
        assert [aside.stat().st_size for aside in tmp_path.glob("spool.damaged-*[0-9]")] == [len(content)]
        found = [batch.samples[0].sequence for batch in drained(spool)]
        assert found == sorted(found)
        assert rows - 20 < len(found) < rows
        assert spool.set_aside["bench"] > 0
        assert spool.waiting["bench"] == 0


def test_damage_that_is_met_in_use_stops_nothing_for_long(tmp_path: Path) -> None:
    rows = 900  # several MB: more than the cache of the database
    fill(tmp_path / "spool", rows, 50)
    with Spool(tmp_path / "spool", ROOM) as spool:
        with (tmp_path / "spool").open("r+b") as file:
            size = file.seek(0, 2)
            file.seek(size // PAGE // 2 * PAGE)
            file.write(b"\x55" * 20 * PAGE)
        found, errors = list[int](), 0
        while errors < 5:
            try:
                for batch in drained(spool):
                    found.append(batch.samples[0].sequence)
            except SpoolError:
                errors += 1
            else:
                break
        assert found == sorted(found)
        assert rows - 100 < len(found) < rows
        assert spool.waiting["bench"] == 0
        assert spool.set_aside["bench"] == 50 * (rows - len(found))
        spool.put("bench", batch_of(0), 0.0)
        assert len(list(drained(spool))) == 1


def test_a_spool_of_an_older_version_is_taken_over(tmp_path: Path) -> None:
    with closing(sqlite3.connect(tmp_path / "spool")) as database, database:
        database.execute("PRAGMA journal_mode = WAL")
        database.execute(
            "CREATE TABLE batch (id INTEGER PRIMARY KEY, surface TEXT NOT NULL, samples INTEGER NOT NULL,"
            " machine_boot TEXT NOT NULL, newest_monotonic_s REAL NOT NULL, content TEXT NOT NULL)"
        )
        database.execute("CREATE INDEX by_surface ON batch (surface, id)")
        for number, content in enumerate((batch_of(0).model_dump_json(), "{}", batch_of(10).model_dump_json()), 1):
            database.execute("INSERT INTO batch VALUES (?, 'bench', 10, 'another boot', 1.0, ?)", (number, content))
    with Spool(tmp_path / "spool", ROOM) as spool:
        assert spool.waiting["bench"] == 30
        assert [batch.samples[0].sequence for batch in drained(spool)] == [0, 10]
        assert spool.waiting["bench"] == 0
        assert spool.set_aside["bench"] == 10


def test_damaged_files_do_not_pile_up(tmp_path: Path) -> None:
    for turn in range(6):
        (tmp_path / "spool").write_bytes(b"this is no database" * 100 + bytes([turn]))
        with Spool(tmp_path / "spool", ROOM):
            pass
    kept = sorted(path.read_bytes()[-1] for path in tmp_path.glob("spool.damaged-*[0-9]"))
    assert kept == [3, 4, 5]


def test_a_spool_whose_file_is_deleted_in_use_goes_on_in_a_new_one_and_counts_what_is_lost(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "spool"
    with Spool(path, 10**6) as spool:
        spool.put("bench", batch_of(0, 3), 0.0)
        for file in tmp_path.iterdir():
            file.unlink()
        spool.put("bench", batch_of(3, 2), 0.0)
        assert (spool.waiting["bench"], spool.dropped["bench"], spool.set_aside["bench"]) == (2, 3, 0)
    with Spool(path, 10**6) as spool:
        assert spool.waiting["bench"] == 2
    assert "was deleted or replaced while in use" in caplog.text
