"""Events of a real process: over a kill, a stop, and a file that cannot be used."""

from __future__ import annotations

import signal
import sqlite3
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
        f"[server]\ntoken_file = '{token_file}'\n[events]\nfile = 'events.db'\n"
        f"[surfaces.press-7]\nmodel = '{build_model()}'\nstale_ms = 60000\n"
    )
    return path


def events(service: Service) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = service.get("/events").json()["events"]
    return found


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGTERM])
def test_events_outlive_the_process_and_an_open_one_is_unfinished(
    start_service: StartService, make_batch: MakeBatch, config: Path, how: signal.Signals
) -> None:
    service = start_service("--config", config)
    service.post(make_batch(RESTING, TOUCHING, RESTING, TOUCHING, TOUCHING))
    assert [event["end"] for event in events(service)] == ["open", "lift"]
    service.stop(how)
    assert (config.parent / "events.db").exists()

    service = start_service("--config", config)
    assert [(event["end"], event["samples"]) for event in events(service)] == [("unfinished", 2), ("lift", 1)]

    # The sender lives on: it sends again what it is not sure of, and what came since.
    service.post(make_batch(TOUCHING, TOUCHING, RESTING, sequence=5))
    assert [(event["end"], event["samples"]) for event in events(service)] == [("lift", 3), ("lift", 1)]


def test_what_the_disk_does_not_take_is_counted_and_the_present_goes_on(
    start_service: StartService, make_batch: MakeBatch, config: Path, wait_for: Wait
) -> None:
    service = start_service("--config", config)
    with closing(sqlite3.connect(config.parent / "events.db", isolation_level=None)) as other:
        other.execute("BEGIN EXCLUSIVE")  # as a backup that hangs
        service.post(make_batch(RESTING, TOUCHING, RESTING))
        assert service.get("/contact").json()["state"] == "clear"
        wait_for(lambda: "beamtouch_event_writes_lost_total 1.0" in service.get("/metrics").text)
        other.execute("ROLLBACK")

    service.post(make_batch(TOUCHING, RESTING, sequence=4))
    assert [(event["end"], event["samples"]) for event in events(service)] == [("lift", 1)]
    code, errors = service.stop(signal.SIGTERM)
    assert code == 0
    assert "events are lost: database is locked" in errors


def test_a_file_of_events_that_cannot_be_used_is_refused_in_one_line(command: Command, config: Path) -> None:
    (config.parent / "events.db").write_text("something else entirely\n" * 100)
    process = command("run", "--port", "0", "--config", config)
    output, errors = process.communicate(timeout=60)

    assert (process.returncode, output) == (2, "")
    (line,) = errors.splitlines()
    assert line.endswith("events.db: file is not a database; set events.file to one that the service can write")
