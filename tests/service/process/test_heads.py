"""Heads of requests over raw sockets: refusals, in any cut into segments, and the order of the answers."""

import json
import re
import select
import socket
import time
from collections import Counter
from collections.abc import Iterator
from itertools import count

import pytest

from beamtouch_service.host.heads import MAX_HEAD_BYTES, MAX_HEADERS

from ..conftest import TOKEN, MakeBatch
from .conftest import Service, touched_in
from .raw import connected, fields, get, said, status

CHUNKED = f"POST /surfaces/press-7/samples HTTP/1.1\r\nHost: x\r\nAuthorization: Bearer {TOKEN}\r\n".encode()
CHUNKED += b"Transfer-Encoding: chunked\r\n\r\n"
PREFIX = "urn:beamtouch:problem:"
NEWER = count(100)
"""Sequence numbers of samples that no batch here has sent."""


def padded(size: int, target: str = "/health/live") -> bytes:
    """Return a request with a head of this size [bytes]."""
    bare = get(target, "X: ")
    return bare[:-4] + b"y" * (size - len(bare)) + b"\r\n\r\n"


def request(*lines: str, first: str = "GET /health/live HTTP/1.1") -> bytes:
    return "\r\n".join([first, *lines, "", ""]).encode("latin-1")


def batch_words(make_batch: MakeBatch, *extra: str) -> bytes:
    """Return a request that sends a batch."""
    body = json.dumps(make_batch(sequence=50)).encode()
    head = ("Host: x", f"Authorization: Bearer {TOKEN}", f"Content-Length: {len(body)}", *extra)
    return request(*head, first="POST /surfaces/press-7/samples HTTP/1.1") + body


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Service]:
    """A service with a contact to give, for tests that leave it as it is but for its counts."""
    with touched_in(tmp_path_factory.mktemp("heads")) as service:
        yield service


def problems(service: Service) -> Counter[str]:
    """Count the problems by kind, as the service does."""
    found = re.findall(r'^beamtouch_problems_total\{kind="(.+)"\} (\d+)', service.get("/metrics").text, re.MULTILINE)
    return Counter({kind: int(count) for kind, count in found})


def assert_refused(
    service: Service, answer: tuple[bytes, bytes], expected: int, slug: str, before: Counter[str]
) -> None:
    """An answer is this problem, and no other was counted since `before`."""
    head, body = answer
    assert (status(head), json.loads(body)["type"]) == (expected, PREFIX + slug), body
    assert fields(head)[b"content-type"] == b"application/problem+json"
    assert fields(head)[b"x-content-type-options"] == b"nosniff"
    assert fields(head)[b"connection"] == b"close"
    assert problems(service) - before == {slug: 1}


def said_in_parts(service: Service, words: bytes, part: int) -> bytes:
    """Send in segments of this size; return all that comes until the other side closes."""
    with connected(service) as connection:
        for start in range(0, len(words), part):
            try:
                connection.sendall(words[start : start + part])
            except OSError:  # refused before the end of it
                break
            time.sleep(0.0005)
        with connection.makefile("rb") as stream:
            return stream.read()


@pytest.mark.parametrize("size", [MAX_HEAD_BYTES + 1, 17_000, 100_000])
@pytest.mark.parametrize("before", ["", "contact", "surfaces", "batch", "chunks"])
def test_a_head_that_is_too_long_is_refused_in_one_segment(
    shared: Service, make_batch: MakeBatch, size: int, before: str
) -> None:
    assert shared.post(make_batch(sequence=next(NEWER))).status_code == 200  # the contact is stale after a minute
    problems_before = problems(shared)
    body = json.dumps(make_batch(sequence=50)).encode()
    first = {
        "": b"",
        "contact": get("/contact"),
        "surfaces": get("/surfaces"),
        "batch": batch_words(make_batch),
        "chunks": CHUNKED + b"%x\r\n%b\r\n0\r\n\r\n" % (len(body), body),
    }[before]
    answers = said(shared, first + padded(size), 1 + bool(before), until_closed=True)

    assert [status(head) for head, _ in answers[:-1]] == [200] * bool(before)
    assert_refused(shared, answers[-1], 431, "head-too-large", problems_before)


@pytest.mark.parametrize("part", [1000, 16_000, 200_000])
def test_the_limit_does_not_depend_on_the_segments(shared: Service, part: int) -> None:
    longest, longer = padded(MAX_HEAD_BYTES), padded(MAX_HEAD_BYTES + 1)
    last = get("/health/live", "Connection: close")
    assert said_in_parts(shared, longest * 3 + last, part).count(b"HTTP/1.1 200 ") == 4
    answers = said_in_parts(shared, longest + longer + last, part)
    assert (answers.count(b"HTTP/1.1 200 "), answers.count(b"HTTP/1.1 431 "), answers.count(b"HTTP/1.1 ")) == (1, 1, 2)


@pytest.mark.parametrize(
    "words",
    [
        b"0\r\n" + b"a: b\r\n" * 3000 + b"\r\n",
        b"0\r\na: " + b"b" * 20_000 + b"\r\n\r\n",
        b"0\r\na: " + b" " * 20_000 + b"b\r\n\r\n",
        b"2;e=" + b"x" * 20_000 + b"\r\n{}\r\n0\r\n\r\n",
    ],
    ids=["trailers", "one trailer", "blanks", "extension of a chunk"],
)
def test_what_stands_around_chunks_is_bounded_too(shared: Service, words: bytes) -> None:
    problems_before = problems(shared)
    (answer,) = said(shared, CHUNKED + words, 1, until_closed=True)
    assert_refused(shared, answer, 431, "head-too-large", problems_before)


def test_a_chunked_batch_with_trailers_is_taken(touched_service: Service, make_batch: MakeBatch) -> None:
    body = json.dumps(make_batch(sequence=50), indent=1).replace("\n", "\r\n\r\n").encode()
    half = len(body) // 2
    chunks = b"".join(b"%x\r\n%b\r\n" % (len(part), part) for part in (body[:half], body[half:]))
    words = CHUNKED + chunks + b"0\r\na: b\r\n\r\n" + get("/health/live")
    first, second = said(touched_service, words, 2)
    assert json.loads(first[1])["accepted"] == 1
    assert status(second[0]) == 200


@pytest.mark.parametrize(
    ("words", "expected", "slug"),
    [
        (padded(20_000)[:-4], 431, "head-too-large"),
        (request("Host: x", *(f"a: {number}" for number in range(MAX_HEADERS))), 431, "head-too-large"),
        (request(), 400, "bad-request"),
        (request("Host: x", "Host: x"), 400, "bad-request"),
        (request("Host: x", "Host: y", first="GET / HTTP/1.0"), 400, "bad-request"),
        (request("Host: a b"), 400, "bad-request"),
        (request("Host: http://x/"), 400, "bad-request"),
        (request("Host: x:port"), 400, "bad-request"),
        (request("Host: [::1"), 400, "bad-request"),
        (request("Host: x", first="GET http:///contact HTTP/1.1"), 400, "bad-request"),
        (request("Host: x", first="GET http://x HTTP/1.1"), 400, "bad-request"),
        (request("Host: x", "Transfer-Encoding: gzip"), 501, "unknown-coding"),
        (request("Host: x", "Transfer-Encoding: gzip, chunked") + b"0\r\n\r\n", 501, "unknown-coding"),
        (request("Host: x", "Transfer-Encoding: xchunked"), 501, "unknown-coding"),
        (request("Host: x", "Transfer-Encoding: chunked, gzip"), 400, "bad-request"),
        (request("Host: x", "Transfer-Encoding: chunked", "Transfer-Encoding: chunked"), 400, "bad-request"),
        (request("Host: x", "Transfer-Encoding: chunked", first="GET / HTTP/1.0") + b"0\r\n\r\n", 400, "bad-request"),
        (request("Host: x", "Transfer-Encoding: chunked", "Content-Length: 5") + b"0\r\n\r\n", 400, "bad-request"),
        (request("Host: x", "Content-Length: 5", "Transfer-Encoding: chunked") + b"0\r\n\r\n", 400, "bad-request"),
        (request("Host: x", "Content-Length: 2", "Content-Length: 2") + b"{}", 400, "bad-request"),
        (request("Host: x", "Content-Length: 2, 3") + b"{}", 400, "bad-request"),
        (request("Host: x", "Content-Length: +2") + b"{}", 400, "bad-request"),
        (request("Host: x", "A: b\r\n c"), 400, "bad-request"),
        (request("Host: x", "A : b"), 400, "bad-request"),
        (request("Host: x", "A: b\rc"), 400, "bad-request"),
        (request("Host: x", "A: b\nC: d"), 400, "bad-request"),
        (request("Host: x", "A: \0"), 400, "bad-request"),
        (b"GET /contact\r\n\r\n", 400, "bad-request"),
        (request("Host: x", first="GET / HTTP/2.0"), 400, "bad-request"),
        (request("Host: x", first="CONNECT x HTTP/1.1"), 400, "bad-request"),
        ("GET /contact?surface=Pressé HTTP/1.1\r\nHost: x\r\n\r\n".encode(), 400, "bad-request"),
        (b"\x16\x03\x01 nonsense\r\n\r\n", 400, "bad-request"),
    ],
)
def test_what_is_no_request_is_a_problem_that_is_counted(
    shared: Service, words: bytes, expected: int, slug: str
) -> None:
    problems_before = problems(shared)
    (answer,) = said(shared, words, 1, until_closed=True)
    assert_refused(shared, answer, expected, slug, problems_before)


@pytest.mark.parametrize(
    "words",
    [
        request(first="GET /health/live HTTP/1.0"),
        request("Host:"),
        request("Host: press.local:8420"),
        request("Host: [::1]:8420"),
        request("Host: x", first="GET http://other/health/live HTTP/1.1"),
        request("Host: x", "Transfer-Encoding: Chunked") + b"0\r\n\r\n",
        b"\r\n\r\n" + request("Host: x"),
    ],
)
def test_what_is_a_request_is_answered(shared: Service, words: bytes) -> None:
    ((head, body),) = said(shared, words, 1)
    assert (status(head), json.loads(body)) == (200, {"status": "live"})


def test_a_bad_request_does_not_take_the_place_of_an_answer(touched_service: Service, make_batch: MakeBatch) -> None:
    problems_before = problems(touched_service)
    words = get("/surfaces") + batch_words(make_batch) + b"\0garbage\r\n\r\n"
    first, second, third = said(touched_service, words, 3, until_closed=True)

    assert "surfaces" in json.loads(first[1])
    assert (status(second[0]), json.loads(second[1])["accepted"]) == (200, 1)
    assert_refused(touched_service, third, 400, "bad-request", problems_before)


def test_nothing_after_what_is_refused_is_looked_at(shared: Service) -> None:
    problems_before = problems(shared)
    words = request("Host: x", "Transfer-Encoding: gzip, chunked") + b"0\r\n\r\n" + get("/health/live")
    (answer,) = said(shared, words, 1, until_closed=True)
    assert_refused(shared, answer, 501, "unknown-coding", problems_before)


@pytest.mark.parametrize("before", [b"", get("/surfaces"), get("/surfaces") * 3], ids=["alone", "second", "fourth"])
def test_a_body_in_wrong_chunks_is_refused_and_not_waited_for(shared: Service, before: bytes) -> None:
    problems_before = problems(shared)
    answers = said(shared, before + CHUNKED + b"zz\r\n", 1 + before.count(b"GET"), until_closed=True)
    # One that is waited for in vain is refused as too slow.
    assert_refused(shared, answers[-1], 400, "bad-request", problems_before)


def test_who_still_sends_reads_why_it_was_refused(shared: Service) -> None:
    with connected(shared) as connection:
        connection.sendall(padded(50_000))
        assert select.select([connection], [], [], 60)[0]  # the refusal has come
        for _ in range(20):
            connection.sendall(b"y" * 100_000)
        connection.shutdown(socket.SHUT_WR)
        with connection.makefile("rb") as stream:
            assert stream.read().startswith(b"HTTP/1.1 431 ")
