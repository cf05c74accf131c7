"""Contacts asked for over raw connections: in order, complete, and within bounds."""

import json
from pathlib import Path
from typing import Any

import pytest

from ..conftest import READ_TOKEN, BuildModel, MakeBatch
from .conftest import Service, StartService
from .raw import connected, fields, get, said


def without_age(body: bytes) -> dict[str, Any]:
    contact: dict[str, Any] = json.loads(body)
    assert 0 <= contact.pop("age_ms") < 60_000
    return contact


@pytest.mark.parametrize("target", ["/contact", "/contact?surface=press-7", "/surfaces/press-7/contact"])
def test_every_address_of_the_contact_gives_the_same(touched_service: Service, target: str) -> None:
    ((head, body),) = said(touched_service, get(target), 1)
    ((_, other_body),) = said(touched_service, get("/contact", "Content-Length: 0"), 1)

    assert head.splitlines()[0] == b"HTTP/1.1 200 OK"
    assert without_age(body) == without_age(other_body)
    assert fields(head).keys() == {
        b"content-type",
        b"content-length",
        b"cache-control",
        b"x-content-type-options",
        b"content-security-policy",
        b"referrer-policy",
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


def test_a_request_in_single_bytes_is_answered(touched_service: Service) -> None:
    with connected(touched_service) as connection, connection.makefile("rb") as stream:
        for _ in range(2):
            for byte in get("/contact"):
                connection.sendall(bytes([byte]))
            head = b"".join(iter(stream.readline, b"\r\n"))
            assert head.startswith(b"HTTP/1.1 200 OK")
            assert without_age(stream.read(int(fields(head)[b"content-length"])))["surface"] == "press-7"


def test_the_contact_takes_the_read_token(
    start_service: StartService, build_model: BuildModel, token_file: Path, read_token_file: Path, make_batch: MakeBatch
) -> None:
    options = ("--write-token-file", token_file, "--read-token-file", read_token_file, "--stale-ms", "60000")
    service = start_service("--model", build_model(), *options)
    service.post(make_batch())

    words = get("/contact") + get("/contact", "Authorization: Bearer wrong")
    assert [head.split()[1] for head, _ in said(service, words, 2)] == [b"401", b"401"]
    # Of two headers, the first counts.
    twice = ("Authorization: Bearer wrong", f"Authorization: Bearer {READ_TOKEN}")
    assert [head.split()[1] for head, _ in said(service, get("/contact", *twice), 1)] == [b"401"]
    assert service.get("/contact", READ_TOKEN).json()["surface"] == "press-7"
