"""Requests that ask for another protocol: they are answered as if they had not asked (RFC 9110, 7.8)."""

import json
import signal
import time

import pytest

from ..conftest import TOKEN, MakeBatch
from .conftest import Service
from .raw import connected, fields, get, said, status

H2C = ("Connection: Upgrade, HTTP2-Settings", "Upgrade: h2c", "HTTP2-Settings: AAMAAABkAAQCAAAAAAIAAAAA")
WEBSOCKET = ("Connection: keep-alive, Upgrade", "upgrade: websocket", "Sec-WebSocket-Version: 13")


def post(body: bytes, *headers: str, chunked: bool = False) -> bytes:
    """Return a request that sends a batch."""
    length = "Transfer-Encoding: chunked" if chunked else f"Content-Length: {len(body)}"
    lines = ("Host: x", f"Authorization: Bearer {TOKEN}", *headers, length)
    head = "\r\n".join(["POST /surfaces/press-7/samples HTTP/1.1", *lines, "", ""]).encode()
    half = len(body) // 2
    parts = [body[:half], body[half:], b""] if chunked else []
    return head + (b"".join(b"%x\r\n%b\r\n" % (len(part), part) for part in parts) or body)


@pytest.mark.parametrize("chunked", [False, True], ids=["length", "chunks"])
@pytest.mark.parametrize("wish", [H2C, WEBSOCKET], ids=["h2c", "websocket"])
@pytest.mark.parametrize("part", [1, 100, 10_000], ids=["bytes", "parts", "one segment"])
def test_batches_that_ask_for_another_protocol_are_accepted(
    touched_service: Service, make_batch: MakeBatch, wish: tuple[str, ...], part: int, *, chunked: bool
) -> None:
    bodies = [json.dumps(make_batch(sequence=number)).encode() for number in (50, 51)]
    words = b"".join(post(body, *wish, chunked=chunked) for body in bodies) + get("/contact", "Connection: close")
    with connected(touched_service) as connection:
        for start in range(0, len(words), part):
            connection.sendall(words[start : start + part])
            time.sleep(0.0002)
        with connection.makefile("rb") as stream:
            answers = stream.read()

    assert answers.count(b"HTTP/1.1 200 OK") == answers.count(b"HTTP/1.1 ") == 3
    assert answers.count(b'{"accepted":1,"repeated":0,') == 2
    assert b'"sequence":51' in answers


@pytest.mark.parametrize("wish", [H2C, WEBSOCKET], ids=["h2c", "websocket"])
def test_a_question_that_asks_for_another_protocol_is_answered_and_the_connection_goes_on(
    touched_service: Service, wish: tuple[str, ...]
) -> None:
    words = get("/contact", *wish) + get("/surfaces", *wish) + get("/health/live", *wish, version="1.0")
    first, second, third = said(touched_service, words, 3, until_closed=True)

    assert [status(head) for head, _ in (first, second, third)] == [200, 200, 200]
    assert json.loads(first[1])["surface"] == "press-7"
    assert "surfaces" in json.loads(second[1])
    assert b"connection" not in fields(first[0])
    assert fields(third[0])[b"connection"] == b"close"
    assert "pip install" not in touched_service.stop(signal.SIGTERM)[1]


def test_a_batch_that_asks_for_another_protocol_may_be_the_last(
    touched_service: Service, make_batch: MakeBatch
) -> None:
    words = post(json.dumps(make_batch(sequence=50)).encode(), "Connection: Upgrade, close", "Upgrade: h2c")
    ((head, body),) = said(touched_service, words + get("/contact"), 1, until_closed=True)

    assert (status(head), json.loads(body)["accepted"]) == (200, 1)


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (get("/contact", *H2C, "Host: y"), 400),
        (get("http:///contact", *H2C), 400),
        (get("x:80", *H2C, method="CONNECT"), 400),
        (post(b"", *H2C, "Transfer-Encoding: gzip, chunked"), 400),
        (get("/contact", *H2C, "Transfer-Encoding: gzip, chunked"), 501),
        (post(b"{", *H2C), 400),
        (post(b"", *H2C, "X: " + "y" * 17_000), 431),
    ],
    ids=["two hosts", "no host in the target", "connect", "two lengths", "coding", "half a body", "long"],
)
def test_such_a_request_is_refused_like_any_other(touched_service: Service, words: bytes, expected: int) -> None:
    ((head, body),) = said(touched_service, words, 1)
    assert (status(head), json.loads(body)["status"]) == (expected, expected)
