"""Contacts asked for over raw connections: answered at once or by the routes, in order, within bounds."""

import json
import socket
import threading
from pathlib import Path
from typing import Any

import pytest

from ..conftest import BuildModel, MakeBatch
from .conftest import Service, StartService

READ_TOKEN = "a-token-for-reading"  # noqa: S105
MOST_GROWTH_MB = 30.0


@pytest.fixture
def service(
    start_service: StartService, build_model: BuildModel, token_file: Path, tmp_path: Path, make_batch: MakeBatch
) -> Service:
    (tmp_path / "service.toml").write_text('[surfaces.press-7]\nmodel = "press.onnx"\nstale_ms = 60000\n')
    build_model().rename(tmp_path / "press.onnx")
    service = start_service("--config", "service.toml", "--token-file", token_file)
    batch: dict[str, Any] = make_batch()
    assert service.post(batch).status_code == 200
    return service


def said(service: Service, words: bytes, answers: int, *, until_closed: bool = False) -> list[tuple[bytes, bytes]]:
    """Send all at once; return head and body of so many answers, and with `until_closed` see that no more come."""
    host, _, port = service.url.removeprefix("http://").rpartition(":")
    found: list[tuple[bytes, bytes]] = []
    with socket.create_connection((host, int(port)), timeout=30) as connection:
        connection.sendall(words)
        with connection.makefile("rb") as stream:
            for _ in range(answers):
                head = b"".join(iter(stream.readline, b"\r\n"))
                (length,) = [line for line in head.lower().splitlines() if line.startswith(b"content-length")]
                found.append((head, stream.read(int(length.rpartition(b":")[2]))))
            assert not until_closed or stream.read() == b""
    return found


def get(target: str, *headers: str, version: str = "1.1") -> bytes:
    return "\r\n".join([f"GET {target} HTTP/{version}", "Host: x", *headers, "", ""]).encode()


def fields(head: bytes) -> dict[bytes, bytes]:
    pairs = (line.split(b": ", 1) for line in head.splitlines()[1:])
    return {name.lower(): value for name, value in pairs if name.lower() != b"date"}


def without_age(body: bytes) -> dict[str, Any]:
    contact: dict[str, Any] = json.loads(body)
    assert 0 <= contact.pop("age_ms") < 60_000
    return contact


@pytest.mark.parametrize("target", ["/contact", "/contact?surface=press-7", "/surfaces/press-7/contact"])
def test_a_contact_at_once_is_that_of_the_routes(service: Service, target: str) -> None:
    # A length, even of nothing, takes the way through the routes.
    ((head, body),) = said(service, get(target), 1)
    ((routed_head, routed_body),) = said(service, get(target, "Content-Length: 0"), 1)

    assert head.splitlines()[0] == routed_head.splitlines()[0] == b"HTTP/1.1 200 OK"
    assert without_age(body) == without_age(routed_body)
    ours, theirs = fields(head), fields(routed_head)
    # The age has more or fewer digits.
    assert {name: value for name, value in ours.items() if name != b"content-length"} == {
        name: value for name, value in theirs.items() if name != b"content-length"
    }
    assert b"date" in head.lower()


def test_requests_in_one_packet_are_answered_in_their_order(service: Service) -> None:
    words = get("/contact") + get("/surfaces") + get("/contact") + get("/health/live") + get("/contact") + get("/x")
    found = [json.loads(body) for _, body in said(service, words, 6)]

    assert [sorted(one)[0] for one in found] == ["age_ms", "surfaces", "age_ms", "status", "age_ms", "detail"]


@pytest.mark.parametrize(
    "words", [get("/contact", "Connection: close"), get("/contact", version="1.0")], ids=["close", "1.0"]
)
def test_a_connection_ends_with_the_answer_to_the_last_request(service: Service, words: bytes) -> None:
    ((head, body),) = said(service, words + get("/contact"), 1, until_closed=True)

    assert fields(head)[b"connection"] == b"close"
    assert without_age(body)["surface"] == "press-7"


def test_what_comes_in_single_bytes_is_answered_too(service: Service) -> None:
    host, _, port = service.url.removeprefix("http://").rpartition(":")
    with socket.create_connection((host, int(port)), timeout=30) as connection:
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        for _ in range(2):
            for byte in get("/contact"):
                connection.sendall(bytes([byte]))
            assert connection.recv(65536).startswith(b"HTTP/1.1 200 OK")


def test_a_contact_at_once_takes_the_token_for_reading(
    start_service: StartService, build_model: BuildModel, token_file: Path, tmp_path: Path, make_batch: MakeBatch
) -> None:
    (tmp_path / "read").write_text(READ_TOKEN)
    service = start_service(
        "--model", build_model(), "--token-file", token_file, "--read-token-file", tmp_path / "read"
    )
    service.post(make_batch())

    words = get("/contact") + get("/contact", "Authorization: Bearer wrong")
    assert [head.split()[1] for head, _ in said(service, words, 2)] == [b"401", b"401"]
    # The first of two counts, at once as by the routes.
    twice = ("Authorization: Bearer wrong", f"Authorization: Bearer {READ_TOKEN}")
    assert [head.split()[1] for head, _ in said(service, get("/contact", *twice), 1)] == [b"401"]
    assert service.get("/contact", READ_TOKEN).status_code in (200, 503)
    assert service.get("/contact", READ_TOKEN).json().get("type") != "urn:beamtouch:problem:unauthorized"


def test_a_client_that_asks_and_never_reads_costs_little_and_holds_up_nobody(service: Service) -> None:
    host, _, port = service.url.removeprefix("http://").rpartition(":")
    before_mb = resident_mb(service)
    stop = threading.Event()
    with socket.create_connection((host, int(port)), timeout=1) as connection:

        def ask() -> None:
            while not stop.is_set():
                try:
                    connection.send(get("/contact") * 1000)
                except OSError:
                    return

        asking = threading.Thread(target=ask)
        asking.start()
        asking.join(5)  # by then it waits for the service, which waits for it
        statuses = [service.get("/contact").status_code for _ in range(20)]
        stop.set()
        asking.join()

    assert statuses == [200] * 20
    assert resident_mb(service) - before_mb < MOST_GROWTH_MB


def resident_mb(service: Service) -> float:
    status = Path(f"/proc/{service.process.pid}/status").read_text()
    return int(status.split("VmRSS:")[1].split()[0]) / 1e3
