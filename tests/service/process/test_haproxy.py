"""HAProxy with `deploy/haproxy-one.cfg` in front of one service: a line gets its answers while others attack."""

import re
import socket
import ssl
import subprocess
import threading
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any, Self

import httpx2
import pytest

from service.bench import TOKEN, batch_of
from service.process.conftest import Service
from support.network.balancer import answers
from support.network.free_ports import free_port
from support.running.debian_parts import require
from support.running.waiting import wait_until

CONFIG = Path(__file__).parents[3] / "deploy" / "haproxy-one.cfg"
PATIENCE_S = 20.0
"""After which the line misses an answer, on a busy machine, too."""
MAX_OF_ADDRESS = 64


class Dropped(ssl.SSLSocket):
    """Closed when nobody has it: the library leaves one open whose peer has gone before the handshake."""

    def __del__(self) -> None:
        self.close()


class Proxy:
    """HAProxy in front of a service, on a free port."""

    def __init__(self, folder: Path, service: Service, certificate: tuple[Path, Path]) -> None:
        self.port = free_port()
        self.url = f"https://127.0.0.1:{self.port}"
        self.tls = ssl.create_default_context(cafile=str(certificate[0]))
        self.tls.sslsocket_class = Dropped
        pem = folder / "beamtouch.pem"
        pem.write_text("".join(path.read_text() for path in certificate))
        places = {":8443": f"127.0.0.1:{self.port}", "/etc/haproxy/beamtouch.pem": str(pem)}
        text = CONFIG.read_text().replace("server one 127.0.0.1:8420", f"server one {service.url.rpartition('/')[2]}")
        for place, here in places.items():
            assert text.count(place) == 1
            text = text.replace(place, here)
        path = folder / "haproxy.cfg"
        path.write_text(text)
        self.process = subprocess.Popen([require("haproxy", "haproxy"), "-f", path], stderr=subprocess.DEVNULL)

    def connect(self, address: str, *, tls: bool = True) -> socket.socket:
        """Return a connection from this address of loopback."""
        plain = socket.create_connection(("127.0.0.1", self.port), timeout=30, source_address=(address, 0))
        return self.tls.wrap_socket(plain, server_hostname="127.0.0.1") if tls else plain


class Line:
    """A daemon and a client that ask through the proxy, until the end of a block."""

    def __init__(self, proxy: Proxy) -> None:
        self.answers = 0
        """Times that both were answered."""
        self.wrong: list[Any] = []
        self._proxy = proxy
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run)

    def __enter__(self) -> Self:
        self._thread.start()
        self.require_answers()
        return self

    def require_answers(self) -> None:
        """Wait for some answers from now on."""
        before = self.answers
        wait_until(lambda: self.answers > before + 10)

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join(60)

    def _run(self) -> None:
        headers, number = {"Authorization": f"Bearer {TOKEN}"}, 0
        with httpx2.Client(
            base_url=self._proxy.url, verify=self._proxy.tls, headers=headers, trust_env=False, timeout=PATIENCE_S
        ) as client:
            while not self._stop.wait(0.05):
                number += 1
                receipt = client.post("/surfaces/press-7/samples", json=batch_of(sequence=number)).json()
                contact = client.get("/contact").json()
                self.answers += 1
                if (receipt.get("accepted"), contact.get("sequence")) != (1, number):
                    self.wrong.append((receipt, contact))


@pytest.fixture
def proxy(fresh: Service, tmp_path: Path, certificate: tuple[Path, Path]) -> Iterator[tuple[Proxy, Service]]:
    proxy = Proxy(tmp_path, fresh, certificate)
    try:
        wait_until(lambda: _takes(proxy))
        yield proxy, fresh
    finally:
        proxy.process.kill()
        proxy.process.wait(60)


def _takes(proxy: Proxy) -> bool:
    try:
        proxy.connect("127.0.0.1").close()
    except OSError:
        return False
    return True


def _takes_a_byte(connection: socket.socket) -> bool:
    try:
        connection.sendall(b"a")
    except OSError:
        return False
    return True


def _is_closed(connection: socket.socket, within_s: float) -> bool:
    connection.settimeout(within_s)
    try:
        while connection.recv(4096):
            pass
    except TimeoutError:
        return False
    except OSError:
        pass
    return True


@pytest.mark.promise("docs/how-to/two-hosts.md", "limits connections, slow heads and bodies")
@pytest.mark.long
def test_a_line_gets_its_answers_while_others_hold_connections_and_flood(proxy: tuple[Proxy, Service]) -> None:
    front, service = proxy
    with ExitStack() as stack:
        line = stack.enter_context(Line(front))

        # Slow heads: a byte now and then. Each connection is ended after the time for a head.
        slow = [stack.enter_context(front.connect("127.0.0.9")) for _ in range(50)]

        def all_are_ended() -> bool:
            slow[:] = [connection for connection in slow if _takes_a_byte(connection)]
            return not slow

        wait_until(all_are_ended, pause_s=0.5)
        # 1000 connections that never say a word, from 20 addresses.
        idle = [stack.enter_context(front.connect(f"127.0.1.{number % 20 + 1}", tls=False)) for number in range(1000)]
        assert not any(_is_closed(connection, 0.01) for connection in idle[-20:])
        line.require_answers()
        # A flood from one address: it has so many connections at a time, and others get none.
        answered = 0
        for _ in range(2 * MAX_OF_ADDRESS):
            with suppress(OSError):
                connection = stack.enter_context(front.connect("127.0.0.10"))
                connection.sendall(b"GET /health/live HTTP/1.1\r\nHost: x\r\n\r\n")
                answered += connection.recv(4096).startswith(b"HTTP/1.1 200 ")
        assert 0 < answered <= MAX_OF_ADDRESS
        line.require_answers()
    assert line.wrong == []
    assert answers(service.url)


HIDDEN = b"GET /hidden HTTP/1.1\r\nHost: x\r\n\r\n"
SMUGGLED = [
    b"POST /contact HTTP/1.1\r\nHost: x\r\nContent-Length: 5\r\nTransfer-Encoding: chunked\r\n\r\n0\r\n\r\n" + HIDDEN,
    b"POST /contact HTTP/1.1\r\nHost: x\r\nContent-Length: %d\r\nContent-Length: 0\r\n\r\n" % len(HIDDEN) + HIDDEN,
    b"POST /contact HTTP/1.1\r\nHost: x\r\nTransfer-Encoding: xchunked\r\nContent-Length: 0\r\n\r\n" + HIDDEN,
    b"POST /contact HTTP/1.1\r\nHost: x\r\nTransfer-Encoding : chunked\r\n\r\n0\r\n\r\n" + HIDDEN,
    b"POST /contact HTTP/1.1\r\nHost: x\r\nContent-Length: +%d\r\n\r\n" % len(HIDDEN) + HIDDEN,
    b"GET /contact HTTP/1.1\r\nHost: x\r\nHost: y\r\n\r\n" + HIDDEN,
    b"GET /contact HTTP/1.1\r\nHost: x\r\nX: a\nTransfer-Encoding: chunked\r\n\r\n0\r\n\r\n" + HIDDEN,
]
"""Requests of whose end a proxy and a server may have different opinions, with another request behind it."""


def _heard(connection: socket.socket) -> bytes:
    """Return what has come since."""
    connection.settimeout(0.05)
    found = b""
    with suppress(OSError):  # also that nothing comes any more
        while part := connection.recv(65536):
            found += part
    return found


@pytest.mark.promise(
    "docs/how-to/two-hosts.md",
    "and refuses ambiguous requests, which two programs may divide differently (request smuggling).",
)
def test_no_request_is_hidden_in_another(proxy: tuple[Proxy, Service]) -> None:
    front, service = proxy
    with Line(front) as line, ExitStack() as stack:
        connections = [stack.enter_context(front.connect("127.0.0.11")) for _ in SMUGGLED]
        heard = [b"" for _ in SMUGGLED]
        for connection, words in zip(connections, SMUGGLED, strict=True):
            connection.sendall(words)

        def agree() -> bool:
            """Return whether all are answered, and each that the service has seen to its sender, not to others."""
            for index, connection in enumerate(connections):
                heard[index] += _heard(connection)
            statuses = [re.findall(rb"HTTP/1\.1 (\d+)", content) for content in heard]
            counted = re.search(r'beamtouch_problems_total{kind="not-found"} (\S+)', service.get("/metrics").text)
            seen = sum(found.count(b"404") for found in statuses)
            return all(statuses) and seen == float(counted[1] if counted else 0)

        wait_until(agree)
        line.require_answers()
        assert agree()
    assert line.wrong == []


def test_a_body_that_is_too_large_is_refused(proxy: tuple[Proxy, Service]) -> None:
    front, _ = proxy
    with front.connect("127.0.0.12") as connection:
        connection.sendall(b"POST /surfaces/press-7/samples HTTP/1.1\r\nHost: x\r\nContent-Length: 2000000\r\n\r\n")
        assert connection.recv(4096).startswith(b"HTTP/1.1 413 ")
