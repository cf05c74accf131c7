"""A write-ahead log that grows, as another program holds on to an old state of the file: when it is told, and how."""

import os
import sqlite3
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest
from sqlalchemy import Connection, create_engine

from beamtouch_service.record.database import write_ahead
from beamtouch_service.record.database.write_ahead import WriteAheadLog

HOLD = """
import sqlite3, sys
held = sqlite3.connect(sys.argv[1], isolation_level=None)
held.execute("BEGIN")
held.execute("SELECT * FROM one").fetchall()
print(flush=True)
sys.stdin.read()
"""


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "events.db"


@pytest.fixture
def connection(path: Path) -> Iterator[Connection]:
    engine = create_engine(f"sqlite:///{path}")
    with engine.connect() as opened:
        opened.exec_driver_sql("PRAGMA journal_mode=WAL")
        opened.exec_driver_sql("CREATE TABLE one (content BLOB)")
        opened.commit()
        yield opened
    engine.dispose()


def fill(path: Path, connection: Connection) -> int:
    """Write, and return the size of the log."""
    connection.exec_driver_sql("INSERT INTO one VALUES (zeroblob(20000))")
    connection.commit()
    return path.with_name("events.db-wal").stat().st_size


def holding(path: Path) -> sqlite3.Connection:
    """Hold on to the state of the file, as another program would."""
    held = sqlite3.connect(path, isolation_level=None)
    held.execute("BEGIN")
    held.execute("SELECT * FROM one").fetchall()
    return held


def test_a_log_that_nobody_holds_is_written_into_the_file(
    path: Path, connection: Connection, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(write_ahead, "WARN_BYTES", fill(path, connection) - 1)
    monkeypatch.setattr(write_ahead, "MAX_BYTES", 0)
    assert WriteAheadLog(path).reason_to_wait(connection) == ""
    assert not connection.in_transaction()
    assert WriteAheadLog(path.with_name("other.db")).reason_to_wait(connection) == ""


def test_a_log_that_is_held_is_told_from_its_size_on_and_once_an_hour(
    path: Path, connection: Connection, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    log = WriteAheadLog(path)
    with closing(holding(path)):
        size = fill(path, connection)
        for warn_bytes in (size + 1, size):
            monkeypatch.setattr(write_ahead, "WARN_BYTES", warn_bytes)
            assert (log.reason_to_wait(connection), caplog.messages) == ("", [])
        monkeypatch.setattr(write_ahead, "WARN_BYTES", size - 1)
        for _ in range(3):
            assert log.reason_to_wait(connection) == ""
    (line,) = caplog.messages
    # It is this process: no other one has a lock.
    words = f"another program holds on to an old state of {path}, so its write-ahead log has 0 MB; end that program"
    assert line.startswith(f"the record of events: {words}, or its transaction")
    assert line.endswith("(beyond 64 MB, nothing is written)")


def test_beyond_the_limit_nothing_is_written_until_the_program_is_over_that_is_named(
    path: Path, connection: Connection, monkeypatch: pytest.MonkeyPatch
) -> None:
    log, command = WriteAheadLog(path), [sys.executable, "-c", HOLD, str(path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as other:
        assert other.stdout is not None
        other.stdout.readline()
        size = fill(path, connection)
        monkeypatch.setattr(write_ahead, "WARN_BYTES", 1)
        for limit, is_held in ((size, False), (size - 1, True)):
            monkeypatch.setattr(write_ahead, "MAX_BYTES", limit)
            reason = log.reason_to_wait(connection)
            assert bool(reason) is is_held
        assert f"(process {other.pid}) holds on to an old state of {path}" in reason
        other.communicate("")
    assert log.reason_to_wait(connection) == ""


@pytest.mark.parametrize(
    ("locks", "named"),
    [
        ("1: POSIX ADVISORY READ 4711 08:01:{inode} 123 123\n2: POSIX ADVISORY READ 12 08:01:{inode} 123 123", "both"),
        ("1: POSIX ADVISORY READ {own} 08:01:{inode} 123 123", None),
        ("1: POSIX ADVISORY READ 4711 08:01:7{inode} 123 123", None),
        ("1: POSIX ADVISORY READ 99 08:01:{inode} 123 123", None),  # it has just ended
        ("1: POSIX ADVISORY READ many 08:01:{inode} 123 123", None),
        ("1:", None),
        (None, None),
    ],
)
def test_the_programs_that_hold_a_log_are_named_as_far_as_the_system_tells(
    path: Path, connection: Connection, monkeypatch: pytest.MonkeyPatch, locks: str | None, named: str | None
) -> None:
    monkeypatch.setattr(write_ahead, "WARN_BYTES", 1)
    monkeypatch.setattr(write_ahead, "MAX_BYTES", 1)
    names = {"/proc/4711/comm": "backup\n", "/proc/12/comm": "copy it\n"}

    def read(one: Path) -> str:
        if str(one) == "/proc/locks" and locks is not None:
            return locks.format(inode=path.with_name("events.db-shm").stat().st_ino, own=os.getpid())
        if str(one) in names:
            return names[str(one)]
        raise FileNotFoundError

    with closing(holding(path)):
        fill(path, connection)
        monkeypatch.setattr(Path, "read_text", read)
        reason = WriteAheadLog(path).reason_to_wait(connection)
    who = "copy it (process 12), backup (process 4711)" if named else "another program"
    assert reason == (
        f"{who} holds on to an old state of {path}, so its write-ahead log has 0 MB; end that program, or its "
        "transaction"
    )
