"""A real process among clients that mean it no good."""

import json
import signal
import ssl
import time
from pathlib import Path

import httpx2
import pytest

from service.bench import READ_TOKEN, TOKEN, batch_of
from service.process.conftest import Service, StartService
from service.process.connections import read_to_end
from support.network.plain_http import NO_TLS, TIMEOUT_S


@pytest.mark.parametrize("certified", [False, True])
def test_beyond_loopback_a_service_without_tls_warns_and_one_with_a_certificate_answers_over_https(
    start_press: StartService,
    certificate: tuple[Path, Path],
    certified: bool,
) -> None:
    options = ("--certificate-file", certificate[0], "--key-file", certificate[1]) if certified else ()
    service = start_press("--host", "0.0.0.0", *options, read=READ_TOKEN)  # noqa: S104  # the warning is about that
    url = service.url.replace("0.0.0.0", "127.0.0.1")  # noqa: S104  # as above
    assert url.startswith("https:" if certified else "http:")
    context = ssl.create_default_context(cafile=str(certificate[0]))
    assert httpx2.get(f"{url}/health/live", verify=context, trust_env=False, timeout=TIMEOUT_S).is_success
    code, errors = service.stop(signal.SIGTERM)
    assert code == 0
    assert ("no TLS: others on the network can read the tokens" in errors) is not certified


@pytest.mark.promise("docs/reference/http.md", "The service never logs a token.")
def test_no_token_is_ever_in_the_log(start_press: StartService) -> None:
    service = start_press(read=READ_TOKEN)
    wrong = "a-wrong-token-that-someone-mistyped"

    assert service.get("/contact").status_code == 401
    assert service.post(batch_of()).status_code == 200
    for token in (wrong, READ_TOKEN, TOKEN):
        for path in ("/contact", f"/contact?token={token}", f"/surfaces/{token}", f"/{token}"):
            service.get(path, token=token)
            httpx2.post(
                service.url + path, headers={"Authorization": f"Bearer {token}"}, trust_env=False, verify=NO_TLS
            )
        with service.connect() as connection:
            connection.sendall(f"GET /contact HTTP/1.1\r\nHost: x\r\nAuthorization Bearer {token}\r\n\r\n".encode())
            assert read_to_end(connection).startswith(b"HTTP/1.1 400")
    code, errors = service.stop(signal.SIGTERM)

    assert code == 0
    assert "refused (unauthorized)" in errors
    for token in (wrong, READ_TOKEN, TOKEN):
        assert token not in errors
    # Dozens of refusals and four requests that were none: a line for each kind. On the trail: start, model, token.
    of_trail = [line for line in errors.splitlines() if " trail: entry " in line]
    assert len(of_trail) == 3
    assert len(errors.splitlines()) - len(of_trail) <= 3


@pytest.mark.promise("docs/reference/http.md", "time for a batch to arrive")
@pytest.mark.long
def test_a_body_that_trickles_is_given_up_after_ten_seconds(fresh: Service) -> None:
    head = f"POST /surfaces/press-7/samples HTTP/1.1\r\nHost: x\r\nAuthorization: Bearer {TOKEN}\r\n"
    with fresh.connect() as connection:
        connection.sendall(f"{head}Content-Length: 1000\r\n\r\n".encode())
        begin_s = time.monotonic()
        connection.settimeout(1)
        found = b""
        while time.monotonic() - begin_s < 60 and not found:
            connection.sendall(b" ")
            try:
                found = connection.recv(65536)
            except TimeoutError:
                continue
        found += read_to_end(connection)

    assert found.startswith(b"HTTP/1.1 408 ")
    assert json.loads(found.partition(b"\r\n\r\n")[2])["type"] == "urn:beamtouch:problem:too-slow"
    assert time.monotonic() - begin_s > 8
