"""Which databases a record can be opened in, and what is said of the others: the reason, and at first the remedy."""

import sqlite3
from contextlib import closing, suppress
from pathlib import Path

import pytest
from sqlalchemy import Connection, insert, select

from beamtouch_service.record.database.errors import RecordAwayError, RecordUnusableError
from beamtouch_service.record.database.tables import DESTINATIONS
from beamtouch_service.record.writing.transactions import Transactions
from beamtouch_service.sections import EventsSection
from service.record_file import execute

TABLES = Path(__file__).with_name("record_tables.sql")
REMEDY = "set events.file to one that the service can write"


def opened(path: Path) -> Transactions:
    return Transactions(EventsSection(file=path))


def test_a_record_in_a_file_lasts_and_one_in_memory_does_not(tmp_path: Path) -> None:
    for transactions, is_lasting in ((opened(tmp_path / "events.db"), True), (Transactions(EventsSection()), False)):
        with closing(transactions):
            assert (transactions.is_lasting, transactions.away_because) == (is_lasting, "")


def test_a_record_in_a_file_is_on_the_disk_after_each_commit_and_readers_change_nothing(tmp_path: Path) -> None:
    def read(connection: Connection, *names: str) -> list[object]:
        return [connection.exec_driver_sql(f"PRAGMA {name}").scalar() for name in names]

    names = ("journal_mode", "synchronous", "foreign_keys", "page_size", "journal_size_limit")
    with closing(opened(tmp_path / "events.db")) as transactions:
        with transactions.database.writing() as connection:
            # FULL: a commit is there after the power has failed, too. Pages are small, as events are.
            assert read(connection, *names, "query_only") == ["wal", 2, 1, 1024, 4 * 2**20, 0]
        with transactions.database.reading() as connection:
            assert read(connection, "query_only") == [1]
    with closing(Transactions(EventsSection())) as transactions, transactions.database.writing() as connection:
        assert read(connection, "foreign_keys") == [1]


def test_a_file_that_cannot_be_opened_now_is_away_with_the_remedy_and_opened_once_it_can_be(tmp_path: Path) -> None:
    path = tmp_path / "later" / "events.db"
    with closing(opened(path)) as transactions:
        assert transactions.away_because == f"events file {path}: unable to open database file; {REMEDY}"
        with pytest.raises(RecordAwayError):
            transactions.healths()
        path.parent.mkdir()
        assert transactions.healths() == {}


def test_a_file_that_is_no_record_is_refused_with_the_remedy(tmp_path: Path) -> None:
    no_database, other = tmp_path / "text.db", tmp_path / "other.db"
    no_database.write_bytes(b"no database" * 4096)
    execute(other, "CREATE TABLE people (name TEXT)")
    for path, reason in (
        (no_database, "file is not a database"),
        (other, "it is the database of another program"),
    ):
        with pytest.raises(RecordUnusableError) as caught:
            opened(path)
        assert str(caught.value) == f"events file {path}: {reason}; {REMEDY}"


@pytest.mark.promise(
    "deploy/README.md",
    "A version with a new format of the record refuses the old database",
)
@pytest.mark.parametrize("number", [1, 1000])
def test_a_record_of_another_version_is_refused_with_its_format(tmp_path: Path, number: int) -> None:
    path = tmp_path / "events.db"
    opened(path).close()
    opened(path).close()
    execute(path, "UPDATE beamtouch_format SET format = ?", number)
    with pytest.raises(RecordUnusableError) as caught:
        opened(path)
    reason = f"another version of the service wrote it (format {number}); move it away"
    assert str(caught.value) == f"events file {path}: {reason}; {REMEDY}"


def test_a_format_has_these_tables(tmp_path: Path) -> None:
    """Other tables need another format: an old record would be opened, and fail later. Then both go into that file."""
    path = tmp_path / "events.db"
    opened(path).close()
    with closing(sqlite3.connect(path)) as connection:
        statements = connection.execute("SELECT sql FROM sqlite_master WHERE sql IS NOT NULL ORDER BY name").fetchall()
        (number,) = connection.execute("SELECT format FROM beamtouch_format").fetchone()
    lines = "\n".join(f"{statement};" for (statement,) in statements).splitlines()
    text = "\n".join(line.rstrip().expandtabs(4) for line in lines)
    assert f"-- format {number}\n{text}\n" == TABLES.read_text()


def test_of_a_record_that_was_open_the_reason_is_said_without_a_remedy(tmp_path: Path) -> None:
    path = tmp_path / "events.db"
    with closing(opened(path)) as transactions:
        execute(path, "DROP TABLE health")
        with pytest.raises(RecordAwayError, match=r"^no such table: health$") as caught:
            transactions.healths()
        assert not isinstance(caught.value, RecordUnusableError)
        # It is prepared anew, and is no whole record.
        with pytest.raises(RecordAwayError, match=r"no such table: health"):
            transactions.healths()


@pytest.mark.parametrize("fault", [KeyError("of the caller"), ValueError("of the caller")], ids=repr)
@pytest.mark.parametrize("use", ["writing", "reading_as_writer", "reading"])
def test_a_fault_of_the_caller_is_no_damage_of_the_record(tmp_path: Path, use: str, fault: Exception) -> None:
    with closing(opened(tmp_path / "events.db")) as transactions:
        with pytest.raises(type(fault)) as caught, getattr(transactions.database, use)():
            raise fault
        assert caught.value is fault


def test_a_fault_in_the_middle_of_a_transaction_undoes_it(tmp_path: Path) -> None:
    with closing(opened(tmp_path / "events.db")) as transactions:
        with suppress(LookupError), transactions.database.writing() as connection:
            connection.execute(insert(DESTINATIONS).values(name="line-3"))
            raise LookupError
        with transactions.database.reading() as connection:
            assert connection.execute(select(DESTINATIONS)).all() == []
