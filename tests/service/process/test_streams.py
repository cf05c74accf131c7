"""The stream of a real process: what it says, and that no client holds it up."""

import itertools
import json
import signal
import socket
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from threading import Thread
from typing import Any

import httpx2
import pytest

from service.bench import BuildModel, batch_of
from service.process.conftest import Service, StartService
from support.network.plain_http import NO_TLS
from support.running.waiting import wait_until

STATE = {"surface", "contact", "problem", "age_ms", "channels", "length_mm", "width_mm", "sequence", "misfit_limit"}


def states(response: httpx2.Response) -> Iterator[dict[str, Any]]:
    """Yield the data of each event."""
    for line in response.iter_lines():
        if line.startswith("data: "):
            yield json.loads(line.removeprefix("data: "))
        else:
            assert line in {"event: state", ""}


def opened(service: Service, stack: ExitStack, path: str = "/stream") -> httpx2.Response:
    stream = httpx2.stream("GET", service.url + path, trust_env=False, verify=NO_TLS, timeout=60)
    return stack.enter_context(stream)


def deaf(service: Service, stack: ExitStack) -> socket.socket:
    """Ask for a stream and never read it."""
    client = stack.enter_context(socket.socket())
    client.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1024)
    client.connect(("127.0.0.1", service.port))
    client.sendall(b"GET /stream?interval_ms=20 HTTP/1.1\r\nHost: x\r\n\r\n")
    return client


@pytest.mark.promise("docs/reference/http.md", "what `GET /contact` gives")
def test_it_says_what_is_and_what_becomes(fresh: Service) -> None:
    service = fresh
    with ExitStack() as stack:
        response = opened(service, stack, "/surfaces/press-7/stream")
        assert (response.status_code, response.headers["content-type"]) == (200, "text/event-stream; charset=utf-8")
        following = states(response)

        first = next(following)
        assert set(first) == STATE
        assert (first["contact"], first["age_ms"], first["sequence"]) == (None, None, None)
        assert first["problem"]["type"] == "urn:beamtouch:problem:no-samples"
        assert (first["length_mm"], first["width_mm"]) == (400.0, None)
        assert first["channels"][1] == {
            "name": "s2",
            "position_mm": 200.0,
            "deflection_mm": None,
            "quality": "missing",
            "unit": "mm",
        }

        service.post(batch_of(sequence=5))
        state = next(state for state in following if state["sequence"] == 5)
        contact = service.get("/contact").json()
        assert state["problem"] is None
        assert {**state["contact"], "age_ms": 0} == {**contact, "age_ms": 0}
        assert state["channels"][1]["deflection_mm"] == 0.25

        service.post(batch_of([1.0, 0.5, 0.5], sequence=6))
        state = next(state for state in following if state["sequence"] == 6)
        assert (state["contact"], state["problem"]["surface"]) == (None, "press-7")

        # Nothing changes any more, and it goes on saying so.
        again = next(following)
        assert again["sequence"] == 6
        assert again["age_ms"] > state["age_ms"]


@pytest.mark.promise("docs/reference/service-configuration.md", "Open streams. Further ones get 503.")
@pytest.mark.promise("docs/reference/http.md", "503 `too-many-clients` with `Retry-After`")
def test_so_many_streams_and_no_more_until_one_ends(start_press: StartService) -> None:
    service = start_press(server="max_streams = 2")
    with ExitStack() as stack:
        assert [opened(service, stack).status_code for _ in range(2)] == [200, 200]
        refused = service.get("/stream")
        assert refused.status_code == 503
        assert refused.json()["type"] == "urn:beamtouch:problem:too-many-clients"
        assert refused.headers["retry-after"]
        assert service.get("/health/live").status_code == 200

    def admitted() -> bool:
        with ExitStack() as stack:
            return opened(service, stack).status_code == 200

    wait_until(admitted)


@pytest.mark.promise("docs/reference/http.md", "When the service stops, all streams end at once.")
def test_it_stops_with_streams_open_one_of_which_is_not_read(
    start_service: StartService, build_model: BuildModel, token_file: Path
) -> None:
    # Without a configuration, the model names its surface.
    service = start_service("--model", build_model(channels=64), "--write-token-file", token_file)
    with ExitStack() as stack:
        read: list[int] = []

        def follow(response: httpx2.Response) -> None:
            read.append(sum(1 for _ in states(response)))

        readers = [Thread(target=follow, args=(opened(service, stack, "/stream?interval_ms=20"),)) for _ in range(2)]
        for reader in readers:
            reader.start()
        deaf(service, stack)
        for sequence in range(1, 101):
            service.post(batch_of([0.001] * 64, sequence=sequence))

        code, errors = service.stop(signal.SIGTERM)
        assert (code, "Traceback" in errors) == (0, False)
        for reader in readers:
            reader.join()
        # Both came to the regular end of their stream.
        assert len(read) == 2
        assert min(read) > 0


@pytest.mark.promise("docs/reference/http.md", "A client that reads nothing is dropped after some seconds.")
@pytest.mark.long
def test_a_client_that_does_not_read_is_dropped_and_costs_others_nothing(
    start_press: StartService, build_model: BuildModel
) -> None:
    # Many channels, so that the buffers of the system are soon full.
    service = start_press(model=build_model(channels=64), server="max_streams = 1")
    with ExitStack() as stack:
        deaf(service, stack)
        sequence, refused = itertools.count(1), set[int]()

        def is_dropped() -> bool:
            assert service.post(batch_of([0.001] * 64, sequence=next(sequence))).status_code == 200
            contact = service.get("/contact")
            assert contact.status_code == 200, contact.text
            with ExitStack() as attempt:
                status = opened(service, attempt).status_code
            refused.add(status)
            return refused == {200, 503} and status == 200

        wait_until(is_dropped, within_s=120, pause_s=0.1)
    code, errors = service.stop(signal.SIGTERM)
    assert (code, "Traceback" in errors) == (0, False)
