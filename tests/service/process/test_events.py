"""Events of a real process: a kill, a stop, a full disk, a dead sender, and unusable files."""

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
def test_events_survive_the_process_and_an_open_one_is_unfinished(
    start_service: StartService, make_batch: MakeBatch, config: Path, how: signal.Signals
) -> None:
    service = start_service("--config", config)
    service.post(make_batch(RESTING, TOUCHING, RESTING, TOUCHING, TOUCHING))
    assert [event["end"] for event in events(service)] == ["open", "lift"]
    service.stop(how)
    assert (config.parent / "events.db").exists()

    service = start_service("--config", config)
    assert [(event["end"], event["samples"]) for event in events(service)] == [("unfinished", 2), ("lift", 1)]

    # The sender still runs: it repeats samples without a receipt, and sends new ones.
    service.post(make_batch(TOUCHING, TOUCHING, RESTING, sequence=5))
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
    assert [event["end"] for event in events(service)] == ["unfinished"]
    service.post(make_batch(*[odd] * 3, *[RESTING] * 3, sequence=8))
    (event,) = events(service)
    assert (event["kind"], event["begin"], event["end"], event["samples"]) == ("unexplained", "clear", "clear", 0)
    capture = service.get(f"/events/{event['id']}/capture").json()
    # The first two samples of a stretch are not unexplained yet. A new process knows no state that speaks against it.
    assert [sample["sequence"] for sample in capture["samples"]] == list(range(4, 13))


def test_failed_writes_are_counted_and_do_not_affect_the_contact(
    start_service: StartService, make_batch: MakeBatch, config: Path, wait_for: Wait
) -> None:
    service = start_service("--config", config)
    with closing(sqlite3.connect(config.parent / "events.db", isolation_level=None)) as other:
        other.execute("BEGIN EXCLUSIVE")  # like a backup that hangs
        service.post(make_batch(RESTING, TOUCHING, RESTING))
        assert service.get("/contact").json()["state"] == "clear"
        wait_for(lambda: "beamtouch_event_writes_lost_total 1.0" in service.get("/metrics").text)
        other.execute("ROLLBACK")

    service.post(make_batch(TOUCHING, RESTING, sequence=4))
    assert [(event["end"], event["samples"]) for event in events(service)] == [("lift", 1)]
    code, errors = service.stop(signal.SIGTERM)
    assert code == 0
    assert "events are lost: database is locked" in errors


def test_an_unusable_file_is_refused_in_one_line(command: Command, config: Path) -> None:
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
    """End and number of samples of each event, read by another process, without a query to the service."""
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

    # The sender was only delayed.
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

    # The daemon restarts with another boot id, and sends the samples it had spooled before.
    service.post(make_batch(RESTING, TOUCHING, boot_id="boot-0002"))
    service.post(make_batch(TOUCHING, TOUCHING, sequence=4, age_ms=60_000))
    wait_for(lambda: on_record(config)[0] == ("unseen", 4))
    service.post(make_batch(TOUCHING, RESTING, sequence=6, age_ms=50_000))
    wait_for(lambda: ("lift", 5) in on_record(config))
    wait_for(lambda: sorted(on_record(config)) == [("lift", 5), ("stale", 1)])


def test_a_full_disk_leaves_at_most_one_open_event(
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
    # Its lift was seen but not recorded. No more samples come.
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


def test_an_event_that_a_full_disk_left_open_is_answered_as_unseen_or_stale(
    start_service: StartService, make_batch: MakeBatch, config: Path, wait_for: Wait
) -> None:
    service = start_service("--config", config)
    service.post(make_batch(RESTING, TOUCHING, TOUCHING))
    (event,) = events(service)
    assert event["end"] == "open"
    resource.prlimit(service.process.pid, resource.RLIMIT_FSIZE, (0, resource.RLIM_INFINITY))
    service.post(make_batch(RESTING, sequence=4))
    assert [event["end"] for event in events(service)] == ["unseen"]
    assert service.get(f"/events/{event['id']}").json()["end"] == "unseen"
    assert ",unseen," in service.get("/events?format=csv").text
    service.post(make_batch(TOUCHING, sequence=5, age_ms=59_900))
    wait_for(lambda: service.get("/contact").status_code == 503)
    assert [event["end"] for event in events(service)] == ["stale"]
    resource.prlimit(service.process.pid, resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
    wait_for(lambda: on_record(config)[0][0] == "unseen")


@pytest.mark.parametrize("replaced", [False, True])
def test_a_deleted_or_replaced_file_is_an_error_in_the_log(
    start_service: StartService, make_batch: MakeBatch, config: Path, *, replaced: bool
) -> None:
    service = start_service("--config", config)
    service.post(make_batch(RESTING, TOUCHING))
    assert len(events(service)) == 1
    (config.parent / "events.db").unlink()
    if replaced:
        (config.parent / "events.db").touch()
    # The service answers from the file that it still has.
    service.post(make_batch(RESTING, sequence=3))
    assert [event["end"] for event in events(service)] == ["lift"]

    code, errors = service.stop(signal.SIGTERM)
    assert code == 0
    assert errors.count("the file of events was deleted or replaced while open; restart the service") == 1


@pytest.mark.parametrize("other_path", ["events.db", "link.db", "folder/../events.db", "hard.db"])
def test_a_second_service_on_the_same_file_waits_for_it(
    start_service: StartService, make_batch: MakeBatch, config: Path, wait_for: Wait, other_path: str
) -> None:
    service = start_service("--config", config)
    service.post(make_batch(RESTING, TOUCHING, TOUCHING))
    assert [event["end"] for event in events(service)] == ["open"]
    (config.parent / "folder").mkdir()
    (config.parent / "link.db").symlink_to("events.db")
    (config.parent / "hard.db").hardlink_to(config.parent / "events.db")
    second = config.with_name("second.toml")
    second.write_text(config.read_text().replace("events.db", other_path))

    other = start_service("--config", second)
    wait_for(lambda: other.get("/events").status_code == 503)
    assert f"{other_path}: another running service writes to it" in other.get("/events").json()["detail"]
    # The second service changed nothing, and readers are not affected.
    assert on_record(config) == [("open", 2)]
    service.post(make_batch(RESTING, sequence=4))
    assert [event["end"] for event in events(service)] == ["lift"]

    other.stop(signal.SIGKILL)
    service.stop(signal.SIGKILL)
    assert [event["end"] for event in events(start_service("--config", config))] == ["lift"]


def test_a_new_service_takes_the_file_when_the_one_before_has_stopped(
    start_service: StartService, make_batch: MakeBatch, config: Path, wait_for: Wait
) -> None:
    service, other = (start_service("--config", config) for _ in range(2))
    service.post(make_batch(RESTING, TOUCHING, RESTING))
    other.post(make_batch(RESTING, TOUCHING, RESTING, boot_id="boot-0002"))
    wait_for(lambda: other.get("/events").status_code == 503)
    code, _ = service.stop(signal.SIGTERM)
    assert code == 0
    wait_for(lambda: other.get("/events").status_code == 200)
    # What it saw meanwhile was kept.
    assert [event["end"] for event in events(other)] == ["lift", "lift"]
