"""Events of a real process: a kill, a stop, a full disk, a dead sender, and unusable files."""

import resource
import signal
import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from service.conftest import BuildModel, batch_of
from service.event_story import RESTING, TOUCHING
from service.process.conftest import Service, StartService
from waiting import wait_until


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


def test_a_stop_makes_all_durable_and_a_contact_through_it_is_one_event(
    start_service: StartService, config: Path
) -> None:
    rows = [RESTING, TOUCHING, RESTING, TOUCHING, TOUCHING, TOUCHING, RESTING]
    service = start_service("--config", config)
    service.post(batch_of(*rows[:6]) | {"oldest": 1})
    service.stop(signal.SIGTERM)

    service = start_service("--config", config)
    assert [event["end"] for event in events(service)] == ["open", "lift"]
    assert service.post(log(batch_of(rows[6], sequence=7))).json()["expected"] in {7, 8}
    wait_until(lambda: service.post(log(batch_of(rows[6], sequence=7))).json()["expected"] == 8)
    assert [(event["end"], event["samples"]) for event in events(service)] == [("lift", 3), ("lift", 1)]


@pytest.mark.parametrize("times", [3, pytest.param(30, marks=pytest.mark.soak)])
def test_killed_again_and_again_during_contacts_the_record_is_that_of_a_service_without_faults(
    start_service: StartService, config: Path, times: int
) -> None:
    rows = [RESTING, *[TOUCHING] * 11, *[RESTING] * 5] * times
    service, sent = start_service("--config", config), 0

    def asked() -> dict[str, Any]:
        receipt: dict[str, Any] = service.post(log(batch_of() | {"samples": []})).json()
        return receipt

    def catch_up() -> None:
        while (expected := asked()["expected"]) is None or expected <= sent:
            if expected is not None:
                service.post(log(batch_of(*rows[expected - 1 : sent], sequence=expected)))

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


def test_while_another_program_has_the_file_the_cursor_stands(start_service: StartService, config: Path) -> None:
    service = start_service("--config", config)
    with closing(sqlite3.connect(config.parent / "events.db", isolation_level=None)) as other:
        other.execute("BEGIN EXCLUSIVE")  # like a backup that hangs
        service.post(batch_of(RESTING, TOUCHING, RESTING) | {"oldest": 1})
        assert service.get("/contact").json()["state"] == "clear"
        wait_until(lambda: "beamtouch_record_outages_total 1.0" in service.get("/metrics").text)
        assert service.post(log(batch_of() | {"samples": []})).json()["durable"] in {0, None}
        other.execute("ROLLBACK")

    wait_until(lambda: service.get("/events").is_success)
    wait_until(lambda: service.post(log(batch_of(RESTING, TOUCHING, RESTING))).json()["expected"] == 4)
    assert [(event["end"], event["samples"]) for event in events(service)] == [("lift", 1)]
    code, errors = service.stop(signal.SIGTERM)
    assert code == 0
    assert "the record of events is away: database is locked" in errors
    assert "the record of events is back" in errors


def on_record(config: Path) -> list[tuple[str, int]]:
    """End and number of samples of each event, read by another process, without a query to the service."""
    with closing(sqlite3.connect(config.parent / "events.db")) as other:
        return other.execute('SELECT "end", samples FROM events ORDER BY touched_us, id').fetchall()


def test_a_full_disk_costs_no_event(start_service: StartService, config: Path) -> None:
    service = start_service("--config", config)

    def let_files_grow(*, grow: bool) -> None:
        soft = resource.RLIM_INFINITY if grow else 0
        resource.prlimit(service.process.pid, resource.RLIMIT_FSIZE, (soft, resource.RLIM_INFINITY))

    service.post(batch_of(RESTING, TOUCHING, TOUCHING))
    assert [event["end"] for event in events(service)] == ["open"]
    let_files_grow(grow=False)
    service.post(batch_of(RESTING, TOUCHING, sequence=4))
    wait_until(lambda: "beamtouch_record_outages_total 1.0" in service.get("/metrics").text)
    receipt = service.post(batch_of(RESTING, sequence=6)).json()
    assert (receipt["durable"], receipt["expected"]) == (3, 7)
    assert service.get("/contact").json()["state"] == "clear"
    let_files_grow(grow=True)
    wait_until(lambda: on_record(config) == [("lift", 2), ("lift", 1)])
