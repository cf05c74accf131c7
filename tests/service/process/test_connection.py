"""Contacts asked for over raw connections: answered at once or by the routes, in order, within bounds."""

import json
from pathlib import Path
from typing import Any

import pytest

from ..conftest import BuildModel, MakeBatch
from .conftest import Service, StartService
from .raw import connected, fields, get, said

READ_TOKEN = "a-token-for-reading"  # noqa: S105


def without_age(body: bytes) -> dict[str, Any]:
    contact: dict[str, Any] = json.loads(body)
    assert 0 <= contact.pop("age_ms") < 60_000
    return contact


@pytest.mark.parametrize("target", ["/contact", "/contact?surface=press-7", "/surfaces/press-7/contact"])
def test_a_contact_at_once_is_that_of_the_routes(touched_service: Service, target: str) -> None:
    # A length, even of nothing, takes the way through the routes.
    ((head, body),) = said(touched_service, get(target), 1)
    ((routed_head, routed_body),) = said(touched_service, get(target, "Content-Length: 0"), 1)

    assert head.splitlines()[0] == routed_head.splitlines()[0] == b"HTTP/1.1 200 OK"
    assert without_age(body) == without_age(routed_body)
    ours, theirs = fields(head), fields(routed_head)
    # The age has more or fewer digits.
    assert {name: value for name, value in ours.items() if name != b"content-length"} == {
        name: value for name, value in theirs.items() if name != b"content-length"
    }
    assert b"date" in head.lower()


def test_requests_in_one_packet_are_answered_in_their_order(touched_service: Service) -> None:
    words = get("/contact") + get("/surfaces") + get("/contact") + get("/health/live") + get("/contact") + get("/x")
    found = [json.loads(body) for _, body in said(touched_service, words, 6)]

    assert [sorted(one)[0] for one in found] == ["age_ms", "surfaces", "age_ms", "status", "age_ms", "detail"]


@pytest.mark.parametrize(
    "words", [get("/contact", "Connection: close"), get("/contact", version="1.0")], ids=["close", "1.0"]
)
def test_a_connection_ends_with_the_answer_to_the_last_request(touched_service: Service, words: bytes) -> None:
    ((head, body),) = said(touched_service, words + get("/contact"), 1, until_closed=True)

    assert fields(head)[b"connection"] == b"close"
    assert without_age(body)["surface"] == "press-7"


def test_what_comes_in_single_bytes_is_answered_too(touched_service: Service) -> None:
    with connected(touched_service) as connection:
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
