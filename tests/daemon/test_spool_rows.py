"""Rows and structures of the spool that only a look at the content shows to be damaged."""

import sqlite3
import time
from contextlib import closing
from pathlib import Path

import pytest

from beamtouch_daemon.delivery.spool import BOOT_ID, Spool
from beamtouch_service.samples import Batch

from .spools import ROOM, batch_of, drained

PAGE, FRAGMENTS, LEAF = 4096, 7, 13
"""Size of a page, where its header has the number of bytes that it has lost, and how a page of rows begins."""


def first_sequences(spool: Spool) -> list[int]:
    return [batch.samples[0].sequence for batch in drained(spool)]


def filled(path: Path, *batches: Batch) -> None:
    """Make a spool with some batches of the bench."""
    with Spool(path, ROOM) as spool:
        for batch in batches:
            spool.put("bench", batch, time.monotonic())


def changed(path: Path, *statements: str) -> None:
    """Change the file behind the daemon's back, each statement in a connection of its own."""
    for statement in statements:
        with closing(sqlite3.connect(path)) as database, database:
            database.execute("PRAGMA writable_schema = ON")
            database.execute(statement)


@pytest.mark.parametrize(
    ("column", "value", "reason"),
    [("samples", 9, "the columns do not match"), ("newest_monotonic_s", 1e300, "its time is not within this boot")],
)
def test_a_row_without_a_checksum_is_checked_by_what_it_says(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, column: str, value: float, reason: str
) -> None:
    # As an older version has written it, and as this one has taken it over.
    filled(tmp_path / "spool", batch_of(0), batch_of(10), batch_of(20))
    boot = BOOT_ID.read_text().strip()
    changed(
        tmp_path / "spool",
        f"UPDATE batch SET checksum = NULL, machine_boot = '{boot}'",  # noqa: S608
        f"UPDATE batch SET {column} = {value} WHERE id = 2",  # noqa: S608
    )
    with Spool(tmp_path / "spool", ROOM) as spool:
        assert first_sequences(spool) == [0, 20]
        assert spool.set_aside["bench"] == (value if column == "samples" else 10)
        assert spool.waiting["bench"] == 0
    assert reason in caplog.text


def test_a_row_that_only_the_index_still_has_does_not_stand_in_the_way(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "spool"
    filled(path, batch_of(0), batch_of(10), batch_of(20))
    with closing(sqlite3.connect(path)) as database:
        (index,) = database.execute("SELECT sql FROM sqlite_master WHERE name = 'by_surface'").fetchone()
        (page,) = database.execute("SELECT rootpage FROM sqlite_master WHERE name = 'by_surface'").fetchone()
    changed(
        path,
        "DELETE FROM sqlite_master WHERE name = 'by_surface'",
        "DELETE FROM batch WHERE id = 2",
        f"INSERT INTO sqlite_master VALUES ('index', 'by_surface', 'batch', {page}, '{index}')",  # noqa: S608
    )
    with Spool(path, ROOM) as spool:
        assert first_sequences(spool) == [0, 20]
        spool.put("bench", batch_of(30), time.monotonic())
        assert first_sequences(spool) == [30]
    assert "the row is gone" in caplog.text


def test_a_file_whose_page_has_lost_bytes_is_kept_and_its_rows_are_delivered(tmp_path: Path) -> None:
    path = tmp_path / "spool"
    filled(path, batch_of(0), batch_of(10), batch_of(20))
    # One of the rows is no text any more, which the copy must keep as it is.
    changed(path, "UPDATE batch SET content = CAST(x'ff' || CAST(content AS BLOB) AS TEXT) WHERE id = 2")
    content = bytearray(path.read_bytes())
    (first, *_) = (begin for begin in range(PAGE, len(content), PAGE) if content[begin] == LEAF)
    content[first + FRAGMENTS] += 5
    path.write_bytes(content)
    with Spool(path, ROOM) as spool:
        (kept,) = tmp_path.glob("spool.damaged-*[0-9]")
        assert kept.stat().st_size == len(content)
        assert first_sequences(spool) == [0, 20]
        assert spool.set_aside["bench"] == 10
        assert spool.waiting["bench"] == 0
