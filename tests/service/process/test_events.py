"""Events of a real process: over a kill, a stop, and a file that cannot be used."""

from __future__ import annotations

import re
import resource
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
        f"[server]\nwrite_token_file = '{token_file}'\n[events]\nfile = 'events.db'\n"
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


def stale_soon(config: Path) -> Path:
    config.write_text(config.read_text().replace("stale_ms = 60000", "stale_ms = 300"))
    return config


def on_record(config: Path) -> list[tuple[str, int]]:
    """End and number of samples of each event, as another process sees them; nobody asks the service."""
    with closing(sqlite3.connect(config.parent / "events.db")) as other:
        return other.execute('SELECT "end", samples FROM events ORDER BY touched_us, id').fetchall()


def test_an_event_ends_when_its_surface_is_stale_and_goes_on_with_the_next_sample(
    start_service: StartService, make_batch: MakeBatch, config: Path, wait_for: Wait
) -> None:
    service = start_service("--config", stale_soon(config))
    service.post(make_batch(RESTING, TOUCHING, TOUCHING))
    wait_for(lambda: on_record(config) == [("stale", 2)])
    assert service.get("/contact").json()["type"] == "urn:beamtouch:problem:stale"
    (event,) = events(service)
    assert (event["end"], event["lifted_at"], event["samples"]) == ("stale", None, 2)
    assert ",stale," in service.get("/events?format=csv").text

    # The sender was held up only.
    service.post(make_batch(TOUCHING, sequence=4))
    wait_for(lambda: on_record(config)[0][1] == 3)
    wait_for(lambda: on_record(config) == [("stale", 3)])
    service.post(make_batch(RESTING, sequence=5))
    assert [(event["end"], event["samples"]) for event in events(service)] == [("lift", 3)]


def test_late_samples_complete_the_event_of_a_dead_sender(
    start_service: StartService, make_batch: MakeBatch, config: Path, wait_for: Wait
) -> None:
    service = start_service("--config", stale_soon(config))
    service.post(make_batch(RESTING, TOUCHING, TOUCHING))
    wait_for(lambda: on_record(config) == [("stale", 2)])

    # The daemon comes back under another boot id, and sends what its former life had spooled.
    service.post(make_batch(RESTING, TOUCHING, boot_id="boot-0002"))
    service.post(make_batch(TOUCHING, TOUCHING, sequence=4, age_ms=60_000))
    wait_for(lambda: on_record(config)[0] == ("unseen", 4))
    service.post(make_batch(TOUCHING, RESTING, sequence=6, age_ms=50_000))
    wait_for(lambda: ("lift", 5) in on_record(config))
    wait_for(lambda: sorted(on_record(config)) == [("lift", 5), ("stale", 1)])


def test_a_full_disk_leaves_one_open_event_at_most(
    start_service: StartService, make_batch: MakeBatch, config: Path, wait_for: Wait
) -> None:
    service = start_service("--config", config)

    def let_files_grow(*, grow: bool) -> None:
        soft = resource.RLIM_INFINITY if grow else 0
        resource.prlimit(service.process.pid, resource.RLIMIT_FSIZE, (soft, resource.RLIM_INFINITY))

    def lost() -> float:
        (line,) = re.findall(r"^beamtouch_event_writes_lost_total (\S+)$", service.get("/metrics").text, re.MULTILINE)
        return float(line)

    service.post(make_batch(RESTING, TOUCHING, TOUCHING))
    assert [event["end"] for event in events(service)] == ["open"]
    let_files_grow(grow=False)
    service.post(make_batch(RESTING, sequence=4))
    wait_for(lambda: lost() > 0)
    let_files_grow(grow=True)
    # Its lift was seen and is not on record. No sample comes any more.
    wait_for(lambda: on_record(config) == [("unseen", 2)])

    service.post(make_batch(TOUCHING, sequence=5))
    before = lost()
    let_files_grow(grow=False)
    service.post(make_batch(RESTING, TOUCHING, sequence=6))
    wait_for(lambda: lost() > before)
    let_files_grow(grow=True)
    service.post(make_batch(RESTING, TOUCHING, TOUCHING, sequence=8))
    wait_for(lambda: [event["end"] for event in events(service)].count("open") == 1)
    assert [event["end"] for event in events(service)] == ["open", "unseen", "unseen"]
    service.post(make_batch(RESTING, sequence=11))
    assert [event["end"] for event in events(service)] == ["lift", "unseen", "unseen"]


def test_a_file_of_the_older_format_is_upgraded_in_place(
    start_service: StartService, make_batch: MakeBatch, config: Path
) -> None:
    service = start_service("--config", config)
    service.post(make_batch(RESTING, TOUCHING, RESTING, TOUCHING, TOUCHING))
    assert len(events(service)) == 2
    service.stop(signal.SIGKILL)
    with closing(sqlite3.connect(config.parent / "events.db")) as older:
        older.executescript("DROP INDEX by_open; PRAGMA user_version = 1; UPDATE events SET \"end\" = 'open'")

    service = start_service("--config", config)
    assert [event["end"] for event in events(service)] == ["unfinished", "unfinished"]
    service.post(make_batch(TOUCHING, RESTING, sequence=6))
    assert [(event["end"], event["samples"]) for event in events(service)] == [("lift", 3), ("unfinished", 1)]
    with closing(sqlite3.connect(config.parent / "events.db")) as other:
        assert other.execute("PRAGMA user_version").fetchone() == (2,)


@pytest.mark.parametrize("other_path", ["events.db", "link.db", "folder/../events.db", "hard.db"])
def test_a_second_service_on_the_same_file_is_refused(
    start_service: StartService, command: Command, make_batch: MakeBatch, config: Path, other_path: str
) -> None:
    service = start_service("--config", config)
    service.post(make_batch(RESTING, TOUCHING, TOUCHING))
    assert [event["end"] for event in events(service)] == ["open"]
    (config.parent / "folder").mkdir()
    (config.parent / "link.db").symlink_to("events.db")
    (config.parent / "hard.db").hardlink_to(config.parent / "events.db")
    second = config.with_name("second.toml")
    second.write_text(config.read_text().replace("events.db", other_path))

    process = command("run", "--port", "0", "--config", second)
    output, errors = process.communicate(timeout=60)
    assert (process.returncode, output) == (2, "")
    (line,) = errors.splitlines()
    assert f"{other_path}: another running service writes to it" in line
    # It changed nothing, and whoever only reads is not in the way.
    assert on_record(config) == [("open", 2)]
    service.post(make_batch(RESTING, sequence=4))
    assert [event["end"] for event in events(service)] == ["lift"]

    service.stop(signal.SIGKILL)
    assert [event["end"] for event in events(start_service("--config", config))] == ["lift"]


def test_a_service_waits_for_the_former_one_to_stop(
    start_service: StartService, command: Command, config: Path
) -> None:
    service = start_service("--config", config)
    other = command("run", "--port", "0", "--config", config)
    code, _ = service.stop(signal.SIGTERM)
    assert code == 0
    assert other.stdout is not None
    assert other.stdout.readline().startswith("listening on ")
