"""A service without a read token answers to its own names only, whatever a page elsewhere calls this machine."""

import socket
import ssl
from contextlib import closing
from pathlib import Path

import httpx2
import pytest

from service.bench import READ_TOKEN, kind
from support.network.plain_http import TIMEOUT_S

from .conftest import Service, StartService

OWN = (
    *("127.0.0.1", "127.0.0.1:8420", "[::1]", "[::1]:8420", "192.168.0.7:8420", ""),
    *("localhost", "LocalHost:8420", "localhost.", "press.localhost", "gateway", "gateway:8420"),
    *("press.plant.example", "PRESS.plant.example.:8443"),
)
FOREIGN = (
    *("evil.example", "evil.example:8420", "127.0.0.1.evil.example", "localhost.evil.example:8420"),
    *("press.plant.example.evil", "plant.example", "evilpress.plant.example", "127.0.0.1.nip.io", "[::1", "a.b:c"),
)
NAMES = 'names = ["press.plant.example"]'


def ask(service: Service, host: str | None, path: str = "/health/live") -> httpx2.Response:
    """Ask for a name, and for nothing as HTTP/1.0 may, byte by byte."""
    head = "" if host is None else f"Host: {host}\r\n"
    with closing(service.connect()) as connection:
        connection.sendall(f"GET {path} HTTP/1.0\r\n{head}\r\n".encode())
        received = b"".join(iter(lambda: connection.recv(65_536), b""))
    top, _, body = received.partition(b"\r\n\r\n")
    status, *lines = top.decode().split("\r\n")
    headers = [(name, value.strip()) for name, _, value in (line.partition(":") for line in lines)]
    return httpx2.Response(int(status.split()[1]), headers=headers, content=body)


@pytest.mark.promise(
    "deploy/README.md",
    "a service without a read token refuses names that it does not know",
)
@pytest.mark.promise(
    "docs/reference/http.md",
    (
        "Without a read token and without a certificate, the service answers only if it is asked for an address, "
        "`localhost`, a name without a dot, the name of its machine, or one of `server.names`."
    ),
)
@pytest.mark.promise(
    "docs/how-to/proxy.md",
    "A service without a read token refuses names that it does not know (421 `other-name`)",
)
def test_a_service_without_a_read_token_refuses_foreign_names(start_press: StartService) -> None:
    service = start_press(server=NAMES)
    machine = socket.gethostname()
    for host in (None, *OWN, machine, f"{machine.partition('.')[0]}.local:8420"):
        assert (host, ask(service, host).status_code) == (host, 200)
    for host in FOREIGN:
        for path in ("/health/live", "/", "/contact", "/nowhere"):
            answer = ask(service, host, path)
            assert (host, answer.status_code, kind(answer)) == (host, 421, "other-name")
    assert ask(service, "evil.example").json()["detail"] == (
        "This service does not go by the name 'evil.example'. Ask for its address or for localhost; if the name is "
        "right, add it to server.names. With a read token, any name will do."
    )
    assert 'beamtouch_refusals_total{kind="other-name"}' in service.get("/metrics").text


@pytest.mark.promise(
    "docs/reference/service-configuration.md",
    "With a read token, or a certificate, any name will do.",
)
def test_with_a_read_token_or_a_certificate_any_name_will_do(
    start_press: StartService, certificate: tuple[Path, Path]
) -> None:
    service = start_press(read=READ_TOKEN)
    assert ask(service, "press.plant.example").status_code == 200
    assert kind(ask(service, "evil.example", "/contact")) == "unauthorized"
    file, key = certificate
    encrypted = start_press(server=f"certificate_file = '{file}'\nkey_file = '{key}'")
    headers = {"Host": "press.plant.example"}
    url, trusted = f"{encrypted.url}/health/live", ssl.create_default_context(cafile=file)
    assert httpx2.get(url, headers=headers, trust_env=False, verify=trusted, timeout=TIMEOUT_S).status_code == 200


def test_a_name_of_the_configuration_must_be_one(start_press: StartService) -> None:
    with pytest.raises(AssertionError, match=r"server\.names\[0\]: must be the name or address of a host"):
        start_press(server='names = ["http://press"]')
