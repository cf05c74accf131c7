"""What a client may do to a connection, and to those of others: over raw sockets."""

import http.client
import json
import signal
import socket
import ssl
import threading
import time
from contextlib import ExitStack
from pathlib import Path

import pytest

from processes import resident_mb

from ..conftest import TOKEN
from .conftest import Service, StartService
from .raw import closes, connected, fields, get, status

MAX_GROWTH_MB = 30.0
PATIENCE_S = 60.0


def flood(connection: socket.socket, words: bytes, max_bytes: int, read_bytes: int = 0) -> None:
    """Send words again and again until enough was sent, nothing is taken any more, or the other side closes."""
    connection.settimeout(1)
    sent = 0
    try:
        while sent < max_bytes:
            sent += connection.send(words)
            if read_bytes:
                connection.recv(read_bytes)
    except OSError:
        return


def trickle(connection: socket.socket, words: bytes) -> None:
    """Send words every now and then, until the other side closes."""
    try:
        while True:
            connection.sendall(words)
            time.sleep(0.01)
    except OSError:
        return


@pytest.mark.parametrize("target", ["/contact", "/health/live"])
@pytest.mark.parametrize("read_bytes", [0, 2000])
def test_who_asks_and_reads_little_costs_little_and_holds_up_nobody(
    touched_service: Service, target: str, read_bytes: int
) -> None:
    before_mb = resident_mb(touched_service.process.pid)
    with connected(touched_service) as connection:
        asking = threading.Thread(target=flood, args=(connection, get(target) * 1000, 20_000_000, read_bytes))
        asking.start()
        asking.join(5)
        statuses = [touched_service.get("/contact").status_code for _ in range(20)]
        assert resident_mb(touched_service.process.pid) - before_mb < MAX_GROWTH_MB
        touched_service.process.send_signal(signal.SIGTERM)
        touched_service.process.wait(timeout=PATIENCE_S)
        asking.join()

    assert statuses == [200] * 20


def test_a_stop_does_not_wait_for_who_does_not_read(touched_service: Service) -> None:
    with connected(touched_service) as connection:
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        # Few requests with large answers: nothing is wrong with that, but that nobody reads them.
        connection.sendall(get("/openapi.json") * 60)
        assert touched_service.get("/health/live").status_code == 200
        code, errors = touched_service.stop(signal.SIGTERM)

    assert code == 0
    assert "Traceback" not in errors


def test_what_follows_a_chunked_body_is_bounded(touched_service: Service) -> None:
    before_mb = resident_mb(touched_service.process.pid)
    with connected(touched_service) as connection:
        connection.sendall(get("/contact", "Transfer-Encoding: chunked") + b"0\r\n")
        wait_for_end = threading.Thread(target=trickle, args=(connection, b"a:b\r\n" * 2000))
        wait_for_end.start()
        wait_for_end.join(PATIENCE_S)
        assert not wait_for_end.is_alive()

    assert resident_mb(touched_service.process.pid) - before_mb < MAX_GROWTH_MB


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


def test_who_connects_for_tls_and_says_nothing_is_cut_off(
    start_service: StartService, certificate: tuple[Path, Path]
) -> None:
    service = start_service("--certificate-file", certificate[0], "--key-file", certificate[1])
    port = int(service.url.rpartition(":")[2])
    with socket.create_connection(("127.0.0.1", port)) as connection:
        begin_s = time.monotonic()
        # asyncio's own patience is 60 s.
        assert closes(connection, 50)
    assert time.monotonic() - begin_s > 2


def test_unfinished_handshakes_keep_nobody_out(
    start_service: StartService, certificate: tuple[Path, Path], token_file: Path
) -> None:
    service = start_service(
        "--certificate-file", certificate[0], "--key-file", certificate[1], "--write-token-file", token_file
    )
    port, before_mb = int(service.url.rpartition(":")[2]), resident_mb(service.process.pid)
    trusted = ssl.create_default_context(cafile=str(certificate[0]))
    with ExitStack() as stack:
        silent = [stack.enter_context(socket.create_connection(("127.0.0.1", port))) for _ in range(400)]
        daemon = http.client.HTTPSConnection("127.0.0.1", port, timeout=PATIENCE_S, context=trusted)
        stack.callback(daemon.close)
        daemon.request("GET", "/health/live", headers={"Authorization": f"Bearer {TOKEN}"})
        assert daemon.getresponse().status == 200
        # Most of them made room, long before their time was over.
        assert len(list(Path(f"/proc/{service.process.pid}/fd").iterdir())) < 200
        assert resident_mb(service.process.pid) - before_mb < 110  # without bounds 180
        assert closes(silent[0])
