"""Events of a real process: a kill, a stop, a full disk, a dead sender, and unusable files."""

from __future__ import annotations

import resource
import signal
import sqlite3
import threading
import time
from contextlib import closing
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from pathlib import Path

    from service.conftest import BuildModel, MakeBatch
    from service.process.conftest import Command, Service, StartService, Wait

TOUCHING, RESTING = [0.5, 0.25, 0.125], [0.0, 0.0, 0.0]


@pytest.fixture
def config(tmp_path: Path, build_model: BuildModel, token_file: Path) -> Path:
    path = tmp_path / "service.toml"
    path.write_text(
        f"[server]\nwrite_token_file = '{token_file}'\n[events]\nfile = 'events.db'\n"
        f"[surfaces.press-7]\nmodel = '{build_model()}'\nstale_ms = 60000\n"
    )
    return path


def events(service: Service) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = service.get("/events").json()["events"]
    return found


def log(batch: dict[str, Any], oldest: int = 1) -> dict[str, Any]:
    """A part of what a sender has in its log."""
    return batch | {"backlog": True, "newest_age_ms": None, "oldest": oldest}


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGTERM])
def test_a_contact_through_a_restart_of_the_service_is_one_event(
    start_service: StartService, make_batch: MakeBatch, config: Path, how: signal.Signals
) -> None:
    rows = [RESTING, TOUCHING, RESTING, TOUCHING, TOUCHING, TOUCHING, RESTING]
    service = start_service("--config", config)
    service.post(make_batch(*rows[:4]) | {"oldest": 1})
    assert [event["end"] for event in events(service)] == ["open", "lift"]
    service.post(make_batch(*rows[4:6], sequence=5) | {"oldest": 1})
    service.stop(how)

    service = start_service("--config", config)
    assert [event["end"] for event in events(service)] == ["open", "lift"]
    # The sender still has what was not durable.
    receipt = service.post(log(make_batch(sequence=1) | {"samples": []})).json()
    assert receipt["expected"] == (5 if how is signal.SIGKILL else 7)
    rest = make_batch(*rows[receipt["expected"] - 1 :], sequence=receipt["expected"])
    assert service.post(log(rest)).status_code == 200
    assert [(event["end"], event["samples"]) for event in events(service)] == [("lift", 3), ("lift", 1)]


def test_a_stretch_survives_a_kill_with_its_capture_and_goes_on(
    start_service: StartService, make_batch: MakeBatch, config: Path
) -> None:
    odd = [0.5, 0.25, 0.75]
    config.write_text(config.read_text() + "unexplained_after_s = 0.012\n")
    service = start_service("--config", config)
    service.post(make_batch(RESTING, *[odd] * 6))
    assert [(event["kind"], event["end"]) for event in events(service)] == [("unexplained", "open")]
    assert 'beamtouch_unexplained{surface="press-7"} 1.0' in service.get("/metrics").text
    _, errors = service.stop(signal.SIGKILL)
    lines = [line for line in errors.splitlines() if "neither rest nor a single contact" in line]
    assert len(lines) == 1
    assert "surface press-7: since 2026-11-20T23:40:46." in lines[0]

    service = start_service("--config", config)
    service.post(make_batch(*[odd] * 3, *[RESTING] * 3, sequence=8))
    (event,) = events(service)
    assert (event["kind"], event["begin"], event["end"], event["samples"]) == ("unexplained", "clear", "clear", 0)
    capture = service.get(f"/events/{event['id']}").json()["capture"]
    # The first two samples of a stretch are not unexplained yet.
    assert [sample["sequence"] for sample in capture] == list(range(4, 9))


@pytest.mark.parametrize("times", [6, pytest.param(30, marks=pytest.mark.soak)])
def test_killed_again_and_again_during_contacts_the_record_is_that_of_a_service_without_faults(
    start_service: StartService, make_batch: MakeBatch, config: Path, times: int
) -> None:
    rows = [RESTING, *[TOUCHING] * 11, *[RESTING] * 5] * times
    service, sent = start_service("--config", config), 0

    def asked() -> dict[str, Any]:
        receipt: dict[str, Any] = service.post(log(make_batch() | {"samples": []})).json()
        return receipt

    def catch_up() -> None:
        while (expected := asked()["expected"]) is None or expected <= sent:
            if expected is not None:
                service.post(log(make_batch(*rows[expected - 1 : sent], sequence=expected)))

    for number in range(times):
        sent = 17 * number + 6
        catch_up()
        if number % 2:
            events(service)  # makes it durable
        service.stop(signal.SIGKILL)
        service = start_service("--config", config)
    sent = len(rows)
    catch_up()
    found = service.get("/events?limit=1000").json()["events"]
    assert [(event["begin"], event["end"], event["samples"]) for event in found] == [("touch", "lift", 11)] * times


def test_while_another_program_has_the_file_the_cursor_stands(
    start_service: StartService, make_batch: MakeBatch, config: Path, wait_for: Wait
) -> None:
    service = start_service("--config", config)
    with closing(sqlite3.connect(config.parent / "events.db", isolation_level=None)) as other:
        other.execute("BEGIN EXCLUSIVE")  # like a backup that hangs
        service.post(make_batch(RESTING, TOUCHING, RESTING) | {"oldest": 1})
        assert service.get("/contact").json()["state"] == "clear"
        wait_for(lambda: "beamtouch_record_outages_total 1.0" in service.get("/metrics").text)
        assert service.post(log(make_batch() | {"samples": []})).json()["durable"] in {0, None}
        other.execute("ROLLBACK")

    wait_for(lambda: service.get("/events").is_success)
    service.post(log(make_batch(RESTING, TOUCHING, RESTING)))
    assert [(event["end"], event["samples"]) for event in events(service)] == [("lift", 1)]
    code, errors = service.stop(signal.SIGTERM)
    assert code == 0
    assert "the record of events is away: database is locked" in errors
    assert "the record of events is back" in errors


def test_a_commit_that_hangs_at_the_stop_loses_nothing(
    start_service: StartService, make_batch: MakeBatch, config: Path
) -> None:
    rows = [RESTING, TOUCHING, RESTING, TOUCHING, TOUCHING, RESTING]
    service = start_service("--config", config)
    service.post(make_batch(RESTING) | {"oldest": 1})
    assert events(service) == []
    with closing(sqlite3.connect(config.parent / "events.db", isolation_level=None, check_same_thread=False)) as other:
        other.execute("BEGIN IMMEDIATE")
        service.post(make_batch(*rows[:4]) | {"oldest": 1})
        time.sleep(1.2)  # a commit has begun
        service.post(make_batch(*rows[4:], sequence=5) | {"oldest": 1})
        release = threading.Timer(0.5, lambda: other.execute("ROLLBACK"))
        release.start()
        code, _ = service.stop(signal.SIGTERM)
        release.join()
    assert code == 0

    service = start_service("--config", config)
    expected = service.post(log(make_batch() | {"samples": []})).json()["expected"]
    service.post(log(make_batch(*rows[expected - 1 :], sequence=expected) if expected < 7 else make_batch(*rows)))
    assert [(event["end"], event["samples"]) for event in events(service)] == [("lift", 2), ("lift", 1)]


def test_an_unusable_file_is_refused_in_one_line(command: Command, config: Path) -> None:
    (config.parent / "events.db").write_text("something else entirely\n" * 100)
    process = command("run", "--port", "0", "--config", config)
    output, errors = process.communicate(timeout=60)

    assert (process.returncode, output) == (2, "")
    (line,) = errors.splitlines()
    assert line.endswith("events.db: file is not a database; set events.file to one that the service can write")


def on_record(config: Path) -> list[tuple[str, int]]:
    """End and number of samples of each event, read by another process, without a query to the service."""
    with closing(sqlite3.connect(config.parent / "events.db")) as other:
        return other.execute('SELECT "end", samples FROM events ORDER BY touched_us, id').fetchall()


def test_a_full_disk_costs_no_event(
    start_service: StartService, make_batch: MakeBatch, config: Path, wait_for: Wait
) -> None:
    service = start_service("--config", config)

    def let_files_grow(*, grow: bool) -> None:
        soft = resource.RLIM_INFINITY if grow else 0
        resource.prlimit(service.process.pid, resource.RLIMIT_FSIZE, (soft, resource.RLIM_INFINITY))

    service.post(make_batch(RESTING, TOUCHING, TOUCHING))
    assert [event["end"] for event in events(service)] == ["open"]
    let_files_grow(grow=False)
    service.post(make_batch(RESTING, TOUCHING, sequence=4))
    wait_for(lambda: "beamtouch_record_outages_total 1.0" in service.get("/metrics").text)
    receipt = service.post(make_batch(RESTING, sequence=6)).json()
    assert (receipt["durable"], receipt["expected"]) == (3, 7)
    assert service.get("/contact").json()["state"] == "clear"
    let_files_grow(grow=True)
    wait_for(lambda: on_record(config) == [("lift", 2), ("lift", 1)])


@pytest.mark.parametrize("replaced", [False, True])
def test_a_deleted_or_replaced_file_is_an_error_in_the_log(
    start_service: StartService, make_batch: MakeBatch, config: Path, wait_for: Wait, *, replaced: bool
) -> None:
    service = start_service("--config", config)
    service.post(make_batch(RESTING, TOUCHING))
    assert len(events(service)) == 1
    for one in config.parent.glob("events.db*"):
        one.unlink()
    if replaced:
        (config.parent / "events.db").touch()
    service.post(make_batch(RESTING, TOUCHING, sequence=3) | {"oldest": 3})
    # The record begins anew, with what the sender still has.
    wait_for(lambda: service.post(log(make_batch(RESTING, TOUCHING, sequence=3), 3)).json()["durable"] == 4)
    assert [(event["begin"], event["end"]) for event in events(service)] == [("touch", "open")]

    code, errors = service.stop(signal.SIGTERM)
    assert code == 0
    assert errors.count("the file of events was deleted or replaced while open") == 1


def test_two_services_on_one_file_record_each_sample_once(
    start_service: StartService, make_batch: MakeBatch, config: Path
) -> None:
    (config.parent / "link.db").symlink_to("events.db")
    second = config.with_name("second.toml")
    second.write_text(config.read_text().replace("events.db", "link.db"))
    service, other = start_service("--config", config), start_service("--config", second)
    rows = [RESTING, TOUCHING, TOUCHING, TOUCHING, RESTING]
    service.post(make_batch(*rows[:3]) | {"oldest": 1})
    assert [event["end"] for event in events(service)] == ["open"]
    other.post(make_batch(*rows[2:], sequence=3) | {"oldest": 1})
    assert [(event["end"], event["samples"]) for event in events(other)] == [("lift", 3)]
    service.post(make_batch(*rows[3:], sequence=4) | {"oldest": 1})
    assert [(event["end"], event["samples"]) for event in events(service)] == [("lift", 3)]
