"""Events of a real process: a stop, a kill, a locked file, a commit that hangs, and a full disk."""

import os
import resource
import signal
import sqlite3
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from service.bench import PATIENT, batch_of
from service.event_story import RESTING, TOUCHING
from service.process.conftest import Service, StartService
from support.running.waiting import wait_until


@pytest.fixture
def start(start_press: StartService) -> StartService:
    """A function that starts a service whose record is the file `events.db` in the folder of the test."""
    return partial(start_press, sections="[events]\nfile = 'events.db'\n")


def events(service: Service) -> list[dict[str, Any]]:
    """Events, as soon as all that was taken is durable."""

    def is_durable() -> bool:
        receipt = service.post(log(batch_of() | {"samples": []})).json()
        return receipt["expected"] is not None and receipt["durable"] == receipt["expected"] - 1

    wait_until(is_durable)
    found: list[dict[str, Any]] = service.get("/events").json()["events"]
    return found


def log(batch: dict[str, Any]) -> dict[str, Any]:
    """A part of what a sender has in its log."""
    return batch | {"backlog": True, "newest_age_ms": None, "oldest": 1}


def test_a_stop_makes_all_durable_and_a_contact_through_it_is_one_event(start: StartService) -> None:
    rows = [RESTING, TOUCHING, RESTING, TOUCHING, TOUCHING, TOUCHING, RESTING]
    service = start()
    service.post(batch_of(*rows[:6]) | {"oldest": 1})
    service.stop(signal.SIGTERM)

    service = start()
    assert [event["end"] for event in events(service)] == ["open", "lift"]
    assert service.post(log(batch_of(rows[6], sequence=7))).json()["expected"] in {7, 8}
    wait_until(lambda: service.post(log(batch_of(rows[6], sequence=7))).json()["expected"] == 8)
    assert [(event["end"], event["samples"]) for event in events(service)] == [("lift", 3), ("lift", 1)]


def test_a_service_that_is_killed_during_contacts_records_each_of_them_once(start: StartService) -> None:
    kills = 3
    rows = [RESTING, *[TOUCHING] * 11, *[RESTING] * 5] * kills
    service, sent = start(), 0

    def expected() -> int | None:
        sequence: int | None = service.post(log(batch_of() | {"samples": []})).json()["expected"]
        return sequence

    def catch_up() -> None:
        """Send what the service expects, until it has all that was sent."""
        while (sequence := expected()) is None or sequence <= sent:
            if sequence is not None:
                service.post(log(batch_of(*rows[sequence - 1 : sent], sequence=sequence)))

    for number in range(kills):
        sent = 17 * number + 6
        catch_up()
        if number % 2:
            events(service)  # makes what came so far durable
        service.stop(signal.SIGKILL)
        service = start()
    sent = len(rows)
    catch_up()
    assert [(event["begin"], event["end"], event["samples"]) for event in events(service)] == [
        ("touch", "lift", 11)
    ] * kills


def on_record(tmp_path: Path) -> list[tuple[str, int]]:
    """End and number of samples of each event, read by another process, without a query to the service."""
    with closing(sqlite3.connect(tmp_path / "events.db")) as other:
        return other.execute('SELECT "end", samples FROM events ORDER BY touched_us, id').fetchall()


def on_trail(tmp_path: Path) -> list[str]:
    """Action of each entry of the trail, read in the same way."""
    with closing(sqlite3.connect(tmp_path / "events.db")) as other:
        return [action for (action,) in other.execute("SELECT action FROM trail ORDER BY number")]


IMPATIENT = "from beamtouch_service.record.database import sqlite as part; part._BUSY_S = 0.1"


def test_while_another_program_has_the_file_locked_nothing_is_durable_and_nothing_is_lost(
    start: StartService, tmp_path: Path
) -> None:
    service, rows = start(code=f"{PATIENT}\n{IMPATIENT}"), [RESTING, TOUCHING, RESTING]
    with closing(sqlite3.connect(tmp_path / "events.db", isolation_level=None)) as other:
        other.execute("BEGIN EXCLUSIVE")  # like a backup that hangs
        service.post(batch_of(*rows) | {"oldest": 1})
        assert service.get("/contact").json()["state"] == "clear"
        wait_until(lambda: "beamtouch_record_outages_total 1.0" in service.get("/metrics").text)
        assert service.post(log(batch_of() | {"samples": []})).json()["durable"] in {0, None}
        other.execute("ROLLBACK")
    wait_until(lambda: service.get("/events").is_success)
    wait_until(lambda: service.post(log(batch_of(*rows))).json()["expected"] == 4)
    assert [(event["end"], event["samples"]) for event in events(service)] == [("lift", 1)]
    code, errors = service.stop(signal.SIGTERM)
    assert code == 0
    assert "the record of events is away: database is locked" in errors
    assert "the record of events is back" in errors


HANGS = "from beamtouch_service.record.database import sqlite as part; part._BUSY_S = 600.0"
"""As of a disk that does not answer: a commit waits for as long as another program has the file."""


def test_a_commit_that_hangs_does_not_hold_up_a_stop_and_what_is_durable_stays(
    start: StartService, tmp_path: Path
) -> None:
    service = start(code=f"{PATIENT}\n{HANGS}")
    service.post(batch_of(RESTING, TOUCHING, RESTING) | {"oldest": 1})
    assert [event["end"] for event in events(service)] == ["lift"]
    with closing(sqlite3.connect(tmp_path / "events.db", isolation_level=None)) as other:
        other.execute("BEGIN EXCLUSIVE")
        assert service.post(batch_of(TOUCHING, sequence=4) | {"oldest": 1}).json()["durable"] == 3
        code, errors = service.stop(signal.SIGTERM)
        assert (code, "Traceback" in errors) == (0, False)
    service = start()
    assert [event["end"] for event in events(service)] == ["lift"]
    assert service.post(log(batch_of() | {"samples": []})).json()["expected"] == 4


SHORT_LOG = """
from beamtouch_service.record import recorder
from beamtouch_service.record.database import write_ahead
write_ahead.WARN_BYTES, write_ahead.MAX_BYTES = 50_000, 100_000
"""


@pytest.mark.promise(
    "docs/reference/events.md",
    (
        "Above 16 MB the log of the service names that program, and above 64 MB the record waits, and with it the "
        "daemons' samples, until the program lets go."
    ),
)
def test_while_another_program_holds_an_old_state_the_log_of_the_file_is_bounded_and_the_program_named(
    start: StartService, tmp_path: Path
) -> None:
    service = start(code=f"{PATIENT}\n{SHORT_LOG}\nrecorder.COMMIT_S = 0.01")
    rows, sent = [RESTING, TOUCHING, RESTING], 0

    def send() -> int:
        nonlocal sent
        service.post(batch_of(*rows, sequence=sent + 1) | {"oldest": 1})
        sent += len(rows)
        return sent

    send()
    wait_until(lambda: on_record(tmp_path) == [("lift", 1)])
    with closing(sqlite3.connect(tmp_path / "events.db", isolation_level=None)) as other:
        other.execute("BEGIN")
        assert other.execute("SELECT count(*) FROM events").fetchone() == (1,)
        wait_until(lambda: send() > 0 and service.get("/health/ready").status_code == 503)
        reason = service.get("/health/ready").json()["missing"]["events"]
        assert reason.startswith(f"{Path('/proc/self/comm').read_text().strip()} (process {os.getpid()}) holds on to")
        assert reason.endswith("its write-ahead log has 0 MB; end that program, or its transaction")
        size = (tmp_path / "events.db-wal").stat().st_size
        for _ in range(20):
            send()
            assert service.get("/contact").json()["state"] == "clear"
        assert (tmp_path / "events.db-wal").stat().st_size == size
    assert len(events(service)) == min(sent // 3, 50)
    assert service.get("/health/ready").is_success
    _, errors = service.stop(signal.SIGTERM)
    assert errors.count("(beyond 0 MB, nothing is written)") == 1
    assert errors.count("is back") == 1


STOPS_LATE = "from beamtouch_service.record import recorder; recorder.STOP_S = 60.0"
SAYS_WHEN = """
def said(part, name):
    call = getattr(part, name)
    def say(self, *given):
        if not given or given[0]:
            open(name, "a").write("x")
        return call(self, *given)
    setattr(part, name, say)

from beamtouch_service.record import recorder
said(recorder.Transactions, "commit")
said(recorder.Recorder, "close")
"""
"""A character in a file for each commit of something, and for the close."""


def test_a_stop_during_a_commit_makes_durable_what_came_meanwhile(start: StartService, tmp_path: Path) -> None:
    service = start(code=f"{PATIENT}\n{HANGS}\n{STOPS_LATE}\n{SAYS_WHEN}")
    service.post(batch_of(RESTING, TOUCHING, RESTING) | {"oldest": 1})
    wait_until(lambda: on_record(tmp_path) == [("lift", 1)])
    wait_until(lambda: on_trail(tmp_path) == ["start", "model", "token"])  # nothing else is still to be written
    commits = (tmp_path / "commit").stat().st_size
    with closing(sqlite3.connect(tmp_path / "events.db", isolation_level=None)) as other:
        other.execute("BEGIN EXCLUSIVE")
        service.post(batch_of(TOUCHING, sequence=4) | {"oldest": 1})
        wait_until(lambda: (tmp_path / "commit").stat().st_size > commits)
        service.post(batch_of(RESTING, TOUCHING, RESTING, sequence=5) | {"oldest": 1})
        service.process.send_signal(signal.SIGTERM)
        wait_until((tmp_path / "close").exists)
        other.execute("ROLLBACK")
    _, errors = service.process.communicate(timeout=60)
    assert (service.process.wait(), "Traceback" in errors) == (0, False)
    assert on_record(tmp_path) == [("lift", 1), ("lift", 1), ("lift", 1)]


def let_files_grow(service: Service, *, grow: bool) -> None:
    soft = resource.RLIM_INFINITY if grow else 0
    resource.prlimit(service.process.pid, resource.RLIMIT_FSIZE, (soft, resource.RLIM_INFINITY))


def test_a_full_disk_costs_no_event(start: StartService, tmp_path: Path) -> None:
    service = start()
    service.post(batch_of(RESTING, TOUCHING, TOUCHING))
    assert [event["end"] for event in events(service)] == ["open"]
    let_files_grow(service, grow=False)
    service.post(batch_of(RESTING, TOUCHING, sequence=4))
    wait_until(lambda: "beamtouch_record_outages_total 1.0" in service.get("/metrics").text)
    receipt = service.post(batch_of(RESTING, sequence=6)).json()
    assert (receipt["durable"], receipt["expected"]) == (3, 7)
    assert service.get("/contact").json()["state"] == "clear"
    let_files_grow(service, grow=True)
    wait_until(lambda: on_record(tmp_path) == [("lift", 2), ("lift", 1)])
    code, errors = service.stop(signal.SIGTERM)
    assert (code, errors.count("the record of events is away"), errors.count("is back")) == (0, 1, 1)


FULL = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (0, resource.RLIM_INFINITY))"


def test_with_a_disk_that_is_full_from_the_start_answers_come_and_the_record_waits(
    start: StartService, tmp_path: Path
) -> None:
    service, rows = start(code=f"{PATIENT}\n{FULL}"), [RESTING, TOUCHING, RESTING]
    receipt = service.post(batch_of(*rows) | {"oldest": 1}).json()
    assert (receipt["durable"], receipt["expected"]) == (None, None)
    assert service.get("/contact").json()["state"] == "clear"
    ready = service.get("/health/ready")
    assert (ready.status_code, set(ready.json()["missing"])) == (503, {"events"})
    let_files_grow(service, grow=True)
    wait_until(lambda: service.post(log(batch_of(*rows))).json()["expected"] == 4)
    wait_until(lambda: on_record(tmp_path) == [("lift", 1)])
    code, errors = service.stop(signal.SIGTERM)
    assert (code, errors.count("the record of events is away")) == (0, 1)
