"""How old a contact is said to be, by a real process whose clients are slow."""

import itertools
import json
import signal
import socket
import time
from pathlib import Path
from typing import Any

import pytest

from service.bench import TOKEN, batch_of
from service.process.conftest import Service
from support.running.waiting import wait_until

FROZEN_S = 1.0
UNNOTICED_S = 0.1
"""A pause of the service of at most this is not noticed."""


def post(batch: dict[str, Any]) -> bytes:
    body = json.dumps(batch).encode()
    head = f"POST /surfaces/press-7/samples HTTP/1.1\r\nHost: x\r\nAuthorization: Bearer {TOKEN}\r\n"
    return f"{head}Content-Length: {len(body)}\r\n\r\n".encode() + body


def take_receipt(connection: socket.socket) -> None:
    received = b""
    while not received.endswith(b"}"):
        piece = connection.recv(65536)
        assert piece, received
        received += piece
    assert received.startswith(b"HTTP/1.1 200 ")


def is_stopped(service: Service) -> bool:
    return Path(f"/proc/{service.process.pid}/stat").read_text().rpartition(")")[2].split()[0] == "T"


@pytest.mark.parametrize("is_new", [False, True], ids=["kept connection", "new connection"])
def test_samples_that_waited_while_the_service_stood_still_are_as_old_as_they_are(fresh: Service, is_new: bool) -> None:
    service, connection = fresh, fresh.connect()
    assert service.post(batch_of()).status_code == 200
    if not is_new:
        connection.sendall(post(batch_of(sequence=2)))
        take_receipt(connection)
    service.process.send_signal(signal.SIGSTOP)
    try:
        wait_until(lambda: is_stopped(service))
        if is_new:
            connection.close()
            connection = service.connect()
        connection.sendall(post(batch_of(sequence=3)))
        sent_s = time.monotonic()
        wait_until(lambda: time.monotonic() > sent_s + FROZEN_S)
        frozen_s = time.monotonic() - sent_s
    finally:
        service.process.send_signal(signal.SIGCONT)
    take_receipt(connection)
    connection.close()

    contact = service.get("/contact").json()
    assert contact["sequence"] == 3
    # It arrived at an unknown moment since the last look at the connections.
    assert contact["age_ms"] >= (frozen_s - UNNOTICED_S) * 1e3
    # The service is awake: what arrives now is new.
    sequence = itertools.count(4)

    def is_new_again() -> bool:
        assert service.post(batch_of(sequence=next(sequence))).status_code == 200
        age_ms: float = service.get("/contact").json()["age_ms"]
        return age_ms < frozen_s * 1e3

    wait_until(is_new_again)
