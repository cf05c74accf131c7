"""What a client may do to a connection, and to those of others: over raw sockets."""

import http.client
import json
import signal
import socket

import pytest

from ..conftest import TOKEN
from .conftest import Service
from .raw import connected, fields, get, status

MAX_GROWTH_MB = 30.0
PATIENCE_S = 60.0


def test_a_stop_does_not_wait_for_who_does_not_read(touched_service: Service) -> None:
    with connected(touched_service) as connection:
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        # Few requests with large answers: nothing is wrong with that, but that nobody reads them.
        connection.sendall(get("/openapi.json") * 60)
        assert touched_service.get("/health/live").status_code == 200
        code, errors = touched_service.stop(signal.SIGTERM)

    assert code == 0
    assert "Traceback" not in errors


@pytest.mark.parametrize("megabytes", [2, 50])
def test_who_sends_too_much_is_told(touched_service: Service, megabytes: int) -> None:
    connection = http.client.HTTPConnection("127.0.0.1", int(touched_service.url.rpartition(":")[2]), timeout=60)
    headers = {"Authorization": f"Bearer {TOKEN}"}
    connection.request("POST", "/surfaces/press-7/samples", b" " * megabytes * 1_000_000, headers)
    answer = connection.getresponse()

    assert answer.status == 413
    assert json.loads(answer.read())["type"] == "urn:beamtouch:problem:too-large"
    connection.close()


@pytest.mark.parametrize("target", ["/contact", "/health/live", "/surfaces"])
def test_head_is_get_without_the_body(touched_service: Service, target: str) -> None:
    with connected(touched_service) as connection, connection.makefile("rb") as stream:
        connection.sendall(get(target, "Connection: close", method="HEAD"))
        head, _, body = stream.read().partition(b"\r\n\r\n")

    assert (status(head), body) == (200, b"")
    assert int(fields(head)[b"content-length"]) > 0
