"""Idle connections do not keep others out: floods from several addresses of loopback, over raw sockets."""

import json
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import httpx2
import pytest

from plain_http import TIMEOUT_S

from ..conftest import TOKEN, BuildModel, MakeBatch
from .conftest import Service, StartService
from .raw import closes, connected, fields, get

PATIENCE_S = 60.0
ATTACK_S = 4.0
HERE = "127.0.0.1"


def port(service: Service) -> int:
    return int(service.url.rpartition(":")[2])


def connect(service: Service, source: str = HERE) -> socket.socket:
    """Return a connection from this address of loopback."""
    return socket.create_connection((HERE, port(service)), timeout=PATIENCE_S, source_address=(source, 0))


def asks(connection: socket.socket, target: str = "/health/live", *headers: str) -> bytes:
    """Ask on an open connection; return the status line, once all of the answer but that of a stream has come."""
    connection.settimeout(PATIENCE_S)
    connection.sendall(get(target, *headers))
    with connection.makefile("rb", buffering=0) as stream:
        head = b"".join(iter(stream.readline, b"\r\n"))
        left = int(fields(head).get(b"content-length", b"0"))
        while left:
            left -= len(stream.read(left) or b"")
    return head.split(b"\r\n")[0]


Start = Callable[..., Service]


@pytest.fixture
def start(start_service: StartService, build_model: BuildModel, token_file: Path, tmp_path: Path) -> Start:
    """A function that starts a service with a number of places, in all and per address."""

    def start(max_clients: int, per_address: int, *options: str | Path) -> Service:
        (tmp_path / "service.toml").write_text(
            f"[server]\nmax_clients = {max_clients}\nmax_clients_per_address = {per_address}\n"
            f'[surfaces.press-7]\nmodel = "{build_model()}"\nstale_ms = 60000\n'
        )
        return start_service("--config", "service.toml", "--write-token-file", token_file, *options)

    return start


@contextmanager
def flood(service: Service, sources: list[str], words: bytes = b"") -> Iterator[list[int]]:
    """Hold 256 connections that say no more than `words`, and open each again as soon as it is closed."""
    over, opened = threading.Event(), [0]

    def attack() -> None:
        with ExitStack() as stack:
            held: list[socket.socket] = []
            while not over.is_set():
                try:
                    one = stack.enter_context(connect(service, sources[opened[0] % len(sources)]))
                    one.sendall(words)
                except OSError:
                    continue
                held.append(one)
                opened[0] += 1
                if len(held) > 256:
                    held.pop(0).close()

    attackers = threading.Thread(target=attack)
    attackers.start()
    try:
        yield opened
    finally:
        over.set()
        attackers.join()


@pytest.mark.parametrize("sources", [[HERE], [f"127.0.0.{host}" for host in range(2, 10)]], ids=["one", "eight"])
@pytest.mark.parametrize("words", [b"", get("/contact"), b"GET /cont"], ids=["silent", "asked once", "half a head"])
def test_idle_connections_keep_nobody_out(
    start: Start, make_batch: MakeBatch, sources: list[str], words: bytes
) -> None:
    service = start(256, 128)
    statuses: list[int] = []
    with (
        flood(service, sources, words) as opened,
        httpx2.Client(base_url=service.url, trust_env=False, timeout=TIMEOUT_S) as kept,
    ):
        while opened[0] < 300:
            time.sleep(0.01)
        before = opened[0]
        end_s, sequence = time.monotonic() + ATTACK_S, 0
        while time.monotonic() < end_s or opened[0] < before + 300:
            sequence += 1
            statuses.append(service.post(make_batch(sequence=sequence)).status_code)
            statuses.append(service.get("/contact").status_code)
            headers = {"Authorization": f"Bearer {TOKEN}"}
            statuses.append(kept.get("/contact", headers=headers).status_code)
            time.sleep(0.1)
    assert statuses == [200] * len(statuses)


def test_the_longest_idle_of_the_address_that_holds_most_leaves_first(start: Start) -> None:
    service = start(6, 6)
    with ExitStack() as stack:
        first = [stack.enter_context(connect(service, "127.0.0.2")) for _ in range(2)]
        many = [stack.enter_context(connect(service, "127.0.0.3")) for _ in range(4)]
        assert asks(many[1]) == b"HTTP/1.1 200 OK"
        # Who has asked for something comes before who has not.
        last = [stack.enter_context(connect(service)) for _ in range(2)]
        assert [closes(one) for one in (many[0], many[2])] == [True, True]
        assert [asks(one) for one in (*first, many[1], many[3], *last)] == [b"HTTP/1.1 200 OK"] * 6


def test_a_newcomer_has_time_to_ask_although_all_others_are_idle(start: Start) -> None:
    service = start(16, 16)
    with ExitStack() as stack:
        for _ in range(15):
            assert asks(stack.enter_context(connect(service))) == b"HTTP/1.1 200 OK"
        newcomer = stack.enter_context(connect(service))
        for _ in range(14):
            assert asks(stack.enter_context(connect(service))) == b"HTTP/1.1 200 OK"
        assert asks(newcomer) == b"HTTP/1.1 200 OK"


def test_silent_connections_of_one_address_leave_before_the_idle_ones_of_others(start: Start) -> None:
    service = start(16, 8)
    with ExitStack() as stack:
        idle = [stack.enter_context(connect(service, f"127.0.0.{host}")) for host in range(10, 22)]
        assert [asks(one) for one in idle] == [b"HTTP/1.1 200 OK"] * 12
        for _ in range(100):
            stack.enter_context(connect(service, "127.0.0.2"))
        assert asks(stack.enter_context(connect(service, "127.0.0.3"))) == b"HTTP/1.1 200 OK"
        assert sum(not closes_now(one) for one in idle) >= 12


def closes_now(connection: socket.socket) -> bool:
    """Return whether the service has closed a connection that waits for nothing."""
    connection.settimeout(0.0)
    try:
        return connection.recv(1) == b""
    except BlockingIOError:
        return False
    except ConnectionResetError:
        return True


def test_among_equal_addresses_the_longest_idle_leaves_first(start: Start, make_batch: MakeBatch) -> None:
    service = start(4, 4)
    assert service.post(make_batch()).status_code == 200
    with ExitStack() as stack:
        polls, *others = [stack.enter_context(connect(service, f"127.0.0.{host}")) for host in range(2, 6)]
        for one in (polls, *others, polls):
            assert asks(one, "/contact") == b"HTTP/1.1 200 OK"
        for host, leaves in enumerate(others, 6):
            assert asks(stack.enter_context(connect(service, f"127.0.0.{host}")), "/contact") == b"HTTP/1.1 200 OK"
            assert closes(leaves)
            assert asks(polls, "/contact") == b"HTTP/1.1 200 OK"


def test_a_client_that_does_not_read_leaves_before_one_that_polls(start: Start, make_batch: MakeBatch) -> None:
    service = start(6, 6)
    assert service.post(make_batch()).status_code == 200
    with ExitStack() as stack:
        polls = stack.enter_context(connect(service, "127.0.0.2"))
        for host in range(3, 8):
            unread = stack.enter_context(connect(service, f"127.0.0.{host}"))
            unread.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            unread.sendall(get("/openapi.json") * 60)
        # Meanwhile the service has written everything that the clients' sockets take.
        assert {asks(polls, "/contact") for _ in range(200)} == {b"HTTP/1.1 200 OK"}
        for host in range(8, 13):
            assert asks(stack.enter_context(connect(service, f"127.0.0.{host}")), "/contact") == b"HTTP/1.1 200 OK"
        assert asks(polls, "/contact") == b"HTTP/1.1 200 OK"


def test_an_address_may_take_half_of_the_places_unless_the_config_says_otherwise(
    start_service: StartService, build_model: BuildModel, tmp_path: Path
) -> None:
    (tmp_path / "service.toml").write_text(
        f'[server]\nmax_clients = 5\n[surfaces.press-7]\nmodel = "{build_model()}"\n'
    )
    service = start_service("--config", "service.toml")
    with ExitStack() as stack:
        many = [stack.enter_context(connect(service, "127.0.0.2")) for _ in range(4)]
        assert closes(many[0])
        assert [asks(one) for one in many[1:]] == [b"HTTP/1.1 200 OK"] * 3


def test_one_address_does_not_take_all_of_the_room(start: Start) -> None:
    service = start(8, 3)
    with ExitStack() as stack:
        other = stack.enter_context(connect(service, "127.0.0.2"))
        many = [stack.enter_context(connect(service, "127.0.0.3")) for _ in range(10)]
        assert all(closes(one) for one in many[:7])
        assert "beamtouch_connections_evicted_total 7.0" in service.get("/metrics").text
        assert [asks(one) for one in (other, *many[7:])] == [b"HTTP/1.1 200 OK"] * 4


def test_a_token_takes_the_place_of_one_without(start: Start) -> None:
    service = start(4, 4)
    token = f"Authorization: Bearer {TOKEN}"
    with ExitStack() as stack:
        streams = [stack.enter_context(connect(service, "127.0.0.2")) for _ in range(3)]
        assert [asks(one, "/stream?surface=press-7") for one in streams] == [b"HTTP/1.1 200 OK"] * 3
        daemon = stack.enter_context(connect(service))
        assert asks(daemon, "/health/live", token) == b"HTTP/1.1 200 OK"
        # None is idle without a token: no place for one more without, and that the process lives everyone may know.
        assert asks(stack.enter_context(connect(service)), "/surfaces") == b"HTTP/1.1 503 Service Unavailable"
        assert asks(stack.enter_context(connect(service))) == b"HTTP/1.1 200 OK"
        wrong = stack.enter_context(connect(service))
        assert (
            asks(wrong, "/surfaces", "Authorization: Bearer wrong-wrong-wrong") == b"HTTP/1.1 503 Service Unavailable"
        )
        others = [stack.enter_context(connect(service)) for _ in range(3)]
        assert [asks(one, "/surfaces", token) for one in others] == [b"HTTP/1.1 200 OK"] * 3
        # Now all have one. The next takes the place of the longest idle.
        assert asks(stack.enter_context(connect(service)), "/surfaces", token) == b"HTTP/1.1 200 OK"
        assert closes(daemon)
        assert [asks(one, "/surfaces") for one in others] == [b"HTTP/1.1 200 OK"] * 3


def test_an_answer_that_nobody_reads_gives_its_place_up(start: Start) -> None:
    service = start(4, 4)
    with ExitStack() as stack:
        for _ in range(4):
            unread = stack.enter_context(connect(service, "127.0.0.2"))
            unread.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            unread.sendall(get("/openapi.json") * 60)
        deadline_s = time.monotonic() + PATIENCE_S
        while asks(stack.enter_context(connect(service)), "/surfaces") != b"HTTP/1.1 200 OK":
            assert time.monotonic() < deadline_s


def test_newcomers_without_a_place_do_not_pile_up(start: Start) -> None:
    service = start(2, 2)
    with ExitStack() as stack:
        streams = [stack.enter_context(connect(service)) for _ in range(2)]
        assert [asks(one, "/stream") for one in streams] == [b"HTTP/1.1 200 OK"] * 2
        many = [stack.enter_context(connect(service)) for _ in range(60)]
        assert all(closes(one) for one in many)
        streams[0].settimeout(PATIENCE_S)
        assert b"event: state" in streams[0].recv(65536)


@pytest.mark.long
def test_a_head_in_single_bytes_has_ten_seconds(start: Start) -> None:
    service = start(4, 4)
    with connected(service) as connection:
        trickle = threading.Thread(target=_trickle, args=(connection, get("/health/live", "X: " + "y" * 1000)))
        trickle.start()
        trickle.join(PATIENCE_S)
        assert not trickle.is_alive()


def _trickle(connection: socket.socket, words: bytes) -> None:
    """Send byte by byte, until the other side closes."""
    try:
        for byte in words:
            connection.sendall(bytes([byte]))
            time.sleep(0.5)
    except OSError:
        return


def test_the_refusal_of_a_newcomer_says_what_to_do(start: Start) -> None:
    service = start(1, 1)
    with connected(service) as stream:
        assert asks(stream, "/stream") == b"HTTP/1.1 200 OK"
        refused = service.get("/surfaces")
    assert (refused.status_code, refused.headers["connection"]) == (503, "close")
    assert json.loads(refused.text)["type"] == "urn:beamtouch:problem:too-many-clients"
