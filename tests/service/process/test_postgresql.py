"""PostgreSQL as it is found: behind PgBouncer, or with a role that may not do everything."""

import signal
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path

import psycopg
import pytest

from beamtouch_service.record.database.errors import RecordAwayError
from beamtouch_service.record.writing.transactions import Transactions
from beamtouch_service.sections import EventsSection
from service.bench import PATIENT, batch_of
from service.event_story import RESTING, TOUCHING
from service.postgres import PASSWORD, Postgres, at_port
from service.process.conftest import Command, StartService
from service.process.pgbouncer import pooled
from support.running.waiting import wait_until


@pytest.mark.promise(
    "deploy/README.md",
    "PgBouncer may stand in between as it is installed, with `pool_mode` `session` or `transaction`.",
)
@pytest.mark.parametrize("pool_mode", [pytest.param("session", marks=pytest.mark.soak), "transaction"])
def test_the_record_works_through_a_pool(
    start_press: StartService, postgres: Postgres, events_url: str, pool_mode: str
) -> None:
    often = "from beamtouch_service.record import recorder; recorder.COMMIT_S = 0.01"
    contact = [RESTING, TOUCHING, RESTING]
    with pooled(postgres, pool_mode) as port:
        service = start_press(code=f"{PATIENT}\n{often}", sections=f"[events]\nurl = '{at_port(events_url, port)}'\n")
        # Often enough for psycopg to prepare statements, if it were allowed to, and at once for a pool to mix them up.
        with ThreadPoolExecutor(4) as readers:
            answers = readers.map(lambda _: service.get("/events?path=true"), range(100))
            for number in range(50):
                assert service.post(batch_of(*contact, sequence=3 * number + 1) | {"oldest": 1}).is_success
            assert all(answer.is_success for answer in answers)
        question = batch_of() | {"samples": [], "oldest": 1, "backlog": True, "newest_age_ms": None}
        wait_until(lambda: bool(service.post(question).json()["durable"] == 150))
        assert len(service.get("/events").json()["events"]) == 50
        code, errors = service.stop(signal.SIGTERM)
        assert (code, "away" in errors, "Traceback" in errors) == (0, False, False)


def refusal(start: Command, url: str, folder: Path) -> str:
    """Return what a service says that can never use a database."""
    (folder / "service.toml").write_text(f"[events]\nurl = '{url}'\n")
    process = start("run", "--port", "0", "--config", "service.toml")
    _, errors = process.communicate(timeout=60)
    assert (process.wait(), "Traceback" in errors) == (2, False)
    return errors.splitlines()[-1].removeprefix("beamtouch-service: the database of events.url: ")


@pytest.mark.promise(
    "deploy/README.md",
    "The role must be allowed to make tables",
)
def test_a_role_that_may_not_make_tables_or_use_those_of_another_is_told_what_to_do(
    command: Command, postgres: Postgres, events_url: str, tmp_path: Path
) -> None:
    with psycopg.connect(events_url, autocommit=True) as connection:
        connection.execute("DROP ROLE IF EXISTS guest")
        connection.execute(f"CREATE ROLE guest LOGIN PASSWORD '{PASSWORD}'".encode())
        url = events_url.replace("beamtouch:", "guest:")
        grant = "GRANT CREATE ON SCHEMA public TO guest"
        assert refusal(command, url, tmp_path) == f"permission denied for schema public; let its owner run: {grant}"
        Transactions(EventsSection(url=events_url)).close()
        other = "the tables belong to another role: use that one in events.url, or give guest a database"
        assert refusal(command, url, tmp_path) == f"permission denied for table beamtouch_format; {other}"
        # What the first line says helps, in a database of its own.
        url = postgres.create()
        with psycopg.connect(url, autocommit=True) as owner:
            owner.execute(grant.encode())
        Transactions(EventsSection(url=url.replace("beamtouch:", "guest:"))).close()
        with psycopg.connect(url, autocommit=True) as owner:
            owner.execute("DROP OWNED BY guest")
        connection.execute("DROP ROLE guest")


@pytest.mark.parametrize(
    ("pool_mode", "query", "reason"),
    [
        ("statement", "", "pooling mode; set pool_mode = transaction in pgbouncer.ini"),
        ("session", "?options=-cwork_mem%3D8MB", "parameter: options; leave options out of events.url"),
    ],
)
def test_what_a_pool_refuses_is_named_with_what_to_do_until_it_is_mended(
    start_press: StartService, postgres: Postgres, events_url: str, pool_mode: str, query: str, reason: str
) -> None:
    with pooled(postgres, pool_mode) as port:
        service = start_press(sections=f"[events]\nurl = '{at_port(events_url, port)}{query}'\n")
        assert service.get("/health/ready").json()["missing"]["events"].endswith(reason)
        code, errors = service.stop(signal.SIGTERM)
        assert (code, "Traceback" in errors, reason in errors) == (0, False, True)


def test_options_of_the_address_take_the_place_of_the_limits(events_url: str) -> None:
    transactions = Transactions(EventsSection(url=f"{events_url}?options=-cstatement_timeout%3D7s"))
    with transactions.database.writing() as connection:
        assert connection.exec_driver_sql("SHOW statement_timeout").scalar() == "7s"
        assert connection.exec_driver_sql("SHOW lock_timeout").scalar() == "0"
    transactions.close()
    transactions = Transactions(EventsSection(url=events_url))
    for use in (transactions.database.writing, transactions.database.reading_as_writer, transactions.database.reading):
        with use() as connection:
            assert connection.exec_driver_sql("SHOW statement_timeout").scalar() == "20s"
    transactions.close()


@pytest.mark.promise("deploy/README.md", "A standby counts as away.")
def test_a_database_that_takes_no_writes_is_away_until_it_does(events_url: str) -> None:
    """As a standby is until it becomes the primary."""
    database = events_url.rpartition("/")[2].partition("?")[0]
    setting = f'ALTER DATABASE "{database}" SET default_transaction_read_only ='
    with psycopg.connect(events_url, autocommit=True) as connection:
        connection.execute(f"{setting} on")
        transactions = Transactions(EventsSection(url=events_url))
        assert "read-only transaction" in transactions.away_because
        with pytest.raises(RecordAwayError):
            transactions.healths()
        connection.execute("SET default_transaction_read_only = off")
        connection.execute(f"{setting} off")
        # Unlike those of a standby that becomes the primary, its connections stay as they were.
        connection.execute("SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE pid <> pg_backend_pid()")
    with suppress(RecordAwayError):
        transactions.healths()  # its connection has ended
    assert transactions.healths() == {}
    transactions.close()
