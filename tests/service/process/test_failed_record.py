"""Works of the record that fail: each is named, tried again, and does what it was to do once its fault is gone."""

import signal
from pathlib import Path
from typing import NamedTuple

import pytest

from service.bench import PATIENT, batch_of
from service.event_story import RESTING, TOUCHING
from service.process.conftest import Service, StartService
from support.programs.broken import broken
from support.running.waiting import wait_until

REASON = "unexpected error (ZeroDivisionError('division by zero'))"
OFTEN = "from beamtouch_service.record import recorder; recorder.TIDY_S = recorder.COMMIT_S = 0.05"


class Case(NamedTuple):
    """A fault in a work of the record."""

    work: str
    module: str
    owner: str
    function: str


WORKS = [
    Case("commit", "beamtouch_service.record.writing.transactions", "Transactions", "commit"),
    Case("load", "beamtouch_service.record.writing.transactions", "Transactions", "load"),
    Case("upkeep", "beamtouch_service.record.writing.retention", "Retention", "tidy"),
]
HEALTHS = [
    Case("health", "beamtouch_service.record.writing.transactions", "Transactions", "healths"),
    Case("health of a surface", "beamtouch_service.record.recorder", "", "HealthHistory"),
]


def events_missing(service: Service) -> str:
    """Return why readiness says that the record is away."""
    why: str = service.get("/health/ready").json().get("missing", {}).get("events", "")
    return why


@pytest.mark.parametrize("case", WORKS, ids=lambda case: case.work)
def test_a_work_of_the_record_that_fails_is_named_and_done_once_its_fault_is_gone(
    start_press: StartService, tmp_path: Path, case: Case
) -> None:
    fault = tmp_path / "fault"
    fault.touch()
    code = broken(case.module, case.owner, case.function, fault)
    service = start_press(code=f"{PATIENT}\n{OFTEN}\n{code}", sections="[events]\nfile = 'events.db'\n")
    batch = batch_of(RESTING, TOUCHING, RESTING) | {"oldest": 1}
    assert service.post(batch).is_success
    wait_until(lambda: REASON in events_missing(service))
    wait_until(lambda: 'beamtouch_missing{section="events"} 1.0' in service.get("/metrics").text)
    # Answers go on.
    assert service.get("/contact").json()["state"] == "clear"

    fault.unlink()
    wait_until(lambda: service.post(batch).json()["durable"] == 3)
    wait_until(lambda: service.get("/health/ready").is_success)
    assert 'beamtouch_missing{section="events"} 0.0' in service.get("/metrics").text
    assert len(service.get("/events").json()["events"]) == 1
    ended, errors = service.stop(signal.SIGTERM)
    assert ended == 0
    # With its traceback, and no more than once a minute.
    assert errors.count("the record cannot be read or written") == 1
    assert errors.count("ZeroDivisionError: division by zero") == 1
    assert "the record of events is back" in errors


@pytest.mark.parametrize("case", HEALTHS, ids=lambda case: case.work)
def test_a_health_that_could_not_be_read_is_stated_once_its_fault_is_gone(
    start_press: StartService, tmp_path: Path, case: Case
) -> None:
    fault = tmp_path / "fault"
    fault.touch()
    code = broken(case.module, case.owner, case.function, fault)
    service = start_press(code=f"{PATIENT}\n{OFTEN}\n{code}", sections="[events]\nfile = 'events.db'\n")
    wait_until(lambda: REASON in events_missing(service))
    assert service.get("/surfaces/press-7").json()["health"] is None

    fault.unlink()
    wait_until(lambda: service.get("/surfaces/press-7").json()["health"] is not None)
    wait_until(lambda: not events_missing(service))


def test_readers_outlive_the_faults_of_more_queries_than_there_are_threads(
    start_press: StartService, tmp_path: Path
) -> None:
    fault = tmp_path / "fault"
    code = broken("beamtouch_service.api.events", "", "find_events", fault)
    service = start_press(code=f"{PATIENT}\n{code}")
    assert service.post(batch_of(RESTING, TOUCHING, RESTING) | {"oldest": 1}).is_success
    wait_until(lambda: len(service.get("/events").json()["events"]) == 1)
    fault.touch()
    for _ in range(5):
        answer = service.get("/events")
        assert (answer.status_code, answer.json()["type"]) == (500, "urn:beamtouch:problem:internal")
    fault.unlink()
    assert len(service.get("/events").json()["events"]) == 1
