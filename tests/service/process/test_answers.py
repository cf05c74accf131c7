"""A real process, asked over loopback: from no model to a sender that stopped."""

from __future__ import annotations

import signal
import threading
from typing import TYPE_CHECKING

import httpx2

from plain_http import TIMEOUT_S
from waiting import wait_until

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    import httpx2

    from service.conftest import BuildModel, MakeBatch
    from service.process.conftest import Service, StartService


def problem(service: Service) -> str:
    response = service.get("/contact")
    assert response.status_code == 503
    return str(response.json()["type"]).removeprefix("urn:beamtouch:problem:")


def test_without_a_model_there_is_no_contact(start_service: StartService, token_file: Path, tmp_path: Path) -> None:
    (tmp_path / "service.toml").write_text("[surfaces.press-7]\n")

    assert problem(start_service()) == "no-surface"
    assert problem(start_service("--config", "service.toml", "--write-token-file", token_file)) == "no-model"


def test_from_the_first_sample_to_silence(
    start_service: StartService,
    build_model: BuildModel,
    make_batch: MakeBatch,
    token_file: Path,
    wait_for: Callable[[Callable[[], bool]], None],
) -> None:
    service = start_service("--model", build_model(), "--write-token-file", token_file, "--stale-ms", "5000")
    assert problem(service) == "no-samples"

    service.post(make_batch(sequence=1))
    contact = service.get("/contact").json()
    assert (contact["state"], contact["position_mm"], contact["sequence"]) == ("contact", 150.0, 1)
    assert 0 <= contact["age_ms"] <= 5000

    service.post(make_batch([0.0, 0.0, 0.0], sequence=2))
    contact = service.get("/contact").json()
    assert (contact["state"], contact["position_mm"], contact["sequence"]) == ("clear", None, 2)

    wait_for(lambda: service.get("/contact").status_code == 503)
    assert problem(service) == "stale"
    assert service.get("/contact").json()["age_ms"] > 5000


def test_an_answer_does_not_wait_for_the_network(start_service: StartService) -> None:
    service = start_service()

    # On one connection, where an answer in two packets would wait 40 ms for an acknowledgement.
    with httpx2.Client(base_url=service.url, trust_env=False, timeout=TIMEOUT_S) as client:
        wait_until(lambda: client.get("/health/live").elapsed.total_seconds() < 0.02)


def test_a_body_without_an_end_is_cut_off(
    start_service: StartService, build_model: BuildModel, token_file: Path
) -> None:
    service = start_service("--model", build_model(), "--write-token-file", token_file)

    def chunks() -> Iterator[bytes]:
        for _ in range(40):
            yield b" " * 65536

    response = service.post(chunks())
    assert response.status_code == 413
    assert response.json()["type"] == "urn:beamtouch:problem:too-large"
    assert service.get("/health/live").status_code == 200


def test_without_a_token_file_writes_are_refused_and_the_log_says_how_to_allow_them(
    start_service: StartService, build_model: BuildModel, make_batch: MakeBatch
) -> None:
    service = start_service("--model", build_model())

    assert service.post(make_batch()).status_code == 401
    code, errors = service.stop(signal.SIGTERM)
    assert code == 0
    limit, refusal = errors.splitlines()
    assert "start with --write-token-file FILE" in limit
    assert "refused (unauthorized): 1 since" in refusal


def test_sigterm_and_ctrl_c_end_the_service_without_a_word(
    start_service: StartService, build_model: BuildModel, token_file: Path
) -> None:
    for number, code in ((signal.SIGTERM, 0), (signal.SIGINT, 130)):
        service = start_service("--model", build_model(), "--write-token-file", token_file)
        assert service.stop(number) == (code, "")


def test_it_stops_with_a_sender_connected(
    start_service: StartService, build_model: BuildModel, token_file: Path
) -> None:
    service = start_service("--model", build_model(), "--write-token-file", token_file)
    answers: list[httpx2.Response] = []
    sent, release = threading.Event(), threading.Event()

    def slow() -> Iterator[bytes]:
        yield b"{"
        sent.set()
        release.wait(60)
        yield b"}"

    def post() -> None:
        answers.append(service.post(slow()))

    sender = threading.Thread(target=post)
    sender.start()
    assert sent.wait(60)
    # A later connection is answered, so the sender's has been accepted, and does not only wait in the kernel's queue.
    assert service.get("/contact").status_code == 503
    code, errors = service.stop(signal.SIGTERM)
    release.set()
    sender.join()
    assert code == 0
    (answer,) = answers
    assert answer.json()["type"] == "urn:beamtouch:problem:stopping"
    assert "Traceback" not in errors
