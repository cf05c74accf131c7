"""Services whose wall clock is wrong, and is set while they run."""

import signal
import sqlite3
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from service.bench import PATIENT, BuildModel, batch_of
from service.event_story import RESTING, TOUCHING
from service.postgres import rows
from service.process.conftest import Service, service_of
from service.process.wrong_clock import WrongClock
from support.running.waiting import wait_until

OFTEN = f"{PATIENT}\nfrom beamtouch_service.record import recorder\nrecorder.TIDY_S = 0.1"
"""The record is tidied at each of its looks, which are a second apart."""
START = f"import sys\n{OFTEN}\nfrom beamtouch_service.cli import main\nsys.exit(main())"
Start = Callable[[WrongClock, str], Service]


@pytest.fixture
def start(tmp_path: Path, build_model: BuildModel, token_file: Path) -> Iterator[Start]:
    """A function that starts a service under a wrong clock, with further lines of its section `events`."""
    started: list[subprocess.Popen[str]] = []
    config = tmp_path / "service.toml"

    def service(clock: WrongClock, events: str) -> Service:
        surface = f"[surfaces.press-7]\nmodel = '{build_model()}'\nstale_ms = 60000\n"
        config.write_text(f"[server]\nwrite_token_file = '{token_file}'\n[events]\n{events}\n{surface}")
        # Not forked from a process that began under the right clock.
        process = subprocess.Popen(
            [sys.executable, "-c", START, "run", "--port", "0", "--config", config],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            cwd=tmp_path,
            env=clock.environment,
        )
        started.append(process)
        return service_of(process, token_file.read_text().strip())

    yield service
    for process in started:
        process.kill()
        process.communicate()


def touch(service: Service, boot_id: str) -> None:
    """Deliver a contact of a new boot, and wait until it is durable."""
    body = batch_of(RESTING, TOUCHING, TOUCHING, RESTING, boot_id=boot_id) | {"oldest": 1}
    service.post(body)
    backlog = body | {"backlog": True, "newest_age_ms": None}
    wait_until(lambda: service.post(backlog).json()["durable"] == 4)


def events(service: Service) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = service.get("/events").json()["events"]
    return found


def wait_for_looks(read: Callable[[], float]) -> None:
    """Wait until time has passed in a record: its service has looked at the clocks again."""
    begin_s = read()
    wait_until(lambda: read() > begin_s + 1)


def in_file(tmp_path: Path) -> float:
    with closing(sqlite3.connect(tmp_path / "events.db")) as other:
        return float(other.execute("SELECT passed_s FROM time").fetchone()[0])


@pytest.mark.parametrize("offset", ["+3650d", pytest.param("-3650d", marks=pytest.mark.soak)])
def test_a_service_that_starts_with_a_wrong_clock_deletes_nothing(start: Start, tmp_path: Path, offset: str) -> None:
    service = start(WrongClock(tmp_path, "+0"), "file = 'events.db'")
    touch(service, "boot-right")
    service.stop(signal.SIGTERM)
    service = start(WrongClock(tmp_path, offset), "file = 'events.db'")
    touch(service, "boot-wrong")
    wait_for_looks(lambda: in_file(tmp_path))
    assert {event["boot_id"] for event in events(service)} == {"boot-right", "boot-wrong"}


def test_what_was_recorded_before_the_clock_was_set_is_not_older_for_it(start: Start, tmp_path: Path) -> None:
    clock = WrongClock(tmp_path, "-40d")
    service = start(clock, "file = 'events.db'")
    touch(service, "boot-behind")
    wait_for_looks(lambda: in_file(tmp_path))
    for offset in ("+0", "+3650d", "+0"):
        clock.set(offset)
        wait_for_looks(lambda: in_file(tmp_path))
    touch(service, "boot-right")
    assert {event["boot_id"] for event in events(service)} == {"boot-behind", "boot-right"}
    _, errors = service.stop(signal.SIGTERM)
    assert "the clock was set forward by 40 days; events age as before" in errors


@pytest.mark.soak
def test_a_replica_with_a_wrong_clock_deletes_nothing(start: Start, tmp_path: Path, events_url: str) -> None:
    section = f"url = '{events_url}'"
    right = start(WrongClock(tmp_path, "+0"), section)
    touch(right, "boot-right")
    (tmp_path / "other").mkdir()
    wrong = start(WrongClock(tmp_path / "other", "+3650d"), section)
    touch(wrong, "boot-wrong")
    wait_for_looks(lambda: float(rows(events_url, "SELECT passed_s FROM time")[0][0]))
    for service in (right, wrong):
        assert {event["boot_id"] for event in events(service)} == {"boot-right", "boot-wrong"}
    _, errors = wrong.stop(signal.SIGTERM)
    assert (
        "the clock of this machine is 3650 days ahead of that of the database; the record goes by the latter" in errors
    )
