"""Clients that read the record: a bounded number at a time, and none of them holds up an answer."""

import signal
import socket
import threading
from pathlib import Path

import httpx2
import pytest

from service.bench import PATIENT, batch_of, kind
from service.event_story import RESTING, TOUCHING
from service.process.conftest import Service, StartService
from service.record_file import execute
from support.running.waiting import wait_until

WAITS = """
import time
from pathlib import Path
from beamtouch_service.api import events
from beamtouch_service.record.reading import readers
readers.MAX_ANSWERS, readers.SLOT_S, readers.QUERY_S = 2, 0.1, 600.0
find = events.find_events
def wait(reader, **how):
    with open("begun", "a") as begun:
        begun.write("x")
    while not Path("go").exists():
        time.sleep(0.01)
    return find(reader, **how)
events.find_events = wait
"""
"""Readers take as long as the test says, and there is room for two answers."""


@pytest.fixture
def service(start_press: StartService) -> Service:
    service = start_press(code=f"{PATIENT}\n{WAITS}", sections="[events]\nfile = 'events.db'\n")
    service.post(batch_of(RESTING, TOUCHING, RESTING) | {"oldest": 1})
    return service


def durable(service: Service) -> int | None:
    question = batch_of() | {"samples": [], "backlog": True, "newest_age_ms": None, "oldest": 1}
    number: int | None = service.post(question).json()["durable"]
    return number


@pytest.mark.promise("docs/reference/http.md", "after a second, 503 `too-many-clients` with `Retry-After`")
@pytest.mark.promise("docs/reference/events.md", "They hold up no answer and no sample")
def test_beyond_a_number_of_readers_others_are_told_to_come_again_and_nothing_else_waits(
    service: Service, tmp_path: Path
) -> None:
    answers: list[httpx2.Response] = []
    readers = [threading.Thread(target=lambda: answers.append(service.get("/events"))) for _ in range(2)]
    for reader in readers:
        reader.start()
    begun = tmp_path / "begun"
    wait_until(lambda: begun.exists() and begun.stat().st_size == len(readers))
    for path in ("/events", "/events/1", "/surfaces/press-7/calibration-data", "/surfaces/press-7/commissionings"):
        refusal = service.get(path)
        assert (path, kind(refusal), refusal.headers["retry-after"]) == (path, "too-many-clients", "1")
    assert service.get("/contact").json()["state"] == "clear"
    assert service.post(batch_of(TOUCHING, RESTING, sequence=4) | {"oldest": 1}).is_success
    wait_until(lambda: durable(service) == 5)
    assert service.get("/health/ready").is_success

    (tmp_path / "go").touch()
    for reader in readers:
        reader.join()
    assert [len(answer.json()["events"]) for answer in answers] == [2, 2]
    assert service.get("/events").is_success


def test_a_client_that_takes_nothing_keeps_its_slot_only_until_it_leaves(service: Service, tmp_path: Path) -> None:
    (tmp_path / "go").touch()
    rows = [RESTING, *[TOUCHING] * 250] * 30
    expected = 4
    while expected <= len(rows):
        part = batch_of(*rows[expected - 1 : expected + 999], sequence=expected)
        expected = service.post(part | {"backlog": True, "newest_age_ms": None, "oldest": 1}).json()["expected"]
    wait_until(lambda: durable(service) == len(rows))
    connections = [socket.socket() for _ in range(2)]
    for connection in connections:
        # Two hundred answers are then more than what the system holds for a client that reads nothing.
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        connection.connect(("127.0.0.1", service.port))
        connection.sendall(b"GET /events?path=true HTTP/1.1\r\nHost: localhost\r\n\r\n" * 200)
    wait_until(lambda: service.get("/events/1").status_code == 503)
    connections.pop().close()
    wait_until(lambda: service.get("/events/1").is_success)
    connections.pop().close()


@pytest.mark.promise("docs/reference/events.md", "If the record goes away meanwhile, the answer breaks off")
@pytest.mark.parametrize("damage", ["path = substr(path, 2)", "peak_force_n = 'abc'"])
def test_an_answer_whose_end_cannot_be_read_breaks_off(service: Service, tmp_path: Path, damage: str) -> None:
    (tmp_path / "go").touch()
    rows = [RESTING, *[TOUCHING, RESTING] * 60]
    expected = 4
    while expected <= len(rows):
        part = batch_of(*rows[expected - 1 :][:100], sequence=expected)
        expected = service.post(part | {"backlog": True, "newest_age_ms": None, "oldest": 1}).json()["expected"]
    wait_until(lambda: durable(service) == len(rows))
    whole = service.get("/events?path=true")
    assert len(whole.json()["events"]) == 50
    execute(tmp_path / "events.db", f"UPDATE events SET {damage} WHERE id = 11")  # noqa: S608
    received = b""
    with httpx2.stream("GET", f"http://127.0.0.1:{service.port}/events?path=true", timeout=60) as answer:
        assert answer.is_success
        with pytest.raises(httpx2.RemoteProtocolError):  # noqa: PT012
            for piece in answer.iter_raw():
                received += piece
    assert 0 < len(received) < len(whole.content)
    assert whole.content.startswith(received)
    assert service.get("/events/11").status_code == 503
    assert service.get("/contact").json()["state"] == "clear"
    _, errors = service.stop(signal.SIGTERM)
    assert errors.count("an answer from the record broke off: event 11 of surface press-7 cannot be read: ") == 1
    assert "Traceback" not in errors
