"""Chunked bodies over raw sockets: what they cost, and where they end."""

import pytest

from processes import processor_s

from ..conftest import TOKEN
from .conftest import Service
from .raw import connected, get, said, status

MEGABYTE = 1_000_000
TICKS_S = 0.1
"""Ten ticks of the clock that counts the time of a process."""
HEAD = b"POST /surfaces/press-7/samples HTTP/1.1\r\nHost: x\r\nTransfer-Encoding: chunked\r\n"


@pytest.mark.parametrize("size", [MEGABYTE, 1000], ids=["one", "many"])
def test_the_cost_of_a_chunk_does_not_depend_on_its_content(touched_service: Service, size: int) -> None:
    head = HEAD + f"Authorization: Bearer {TOKEN}\r\n\r\n".encode()
    spent_s = []
    for letter in (b"x", b"\n"):
        before_s = processor_s(touched_service.process.pid)
        chunks = (b"%x\r\n%b\r\n" % (size, letter * size)) * (MEGABYTE // size)
        (answer,) = said(touched_service, head + chunks + b"0\r\n\r\n", 1)
        assert status(answer[0]) == 400
        spent_s.append(processor_s(touched_service.process.pid) - before_s)
    # With one piece per line end, it was 1.5 s more. Below TICKS_S, processor time says little.
    assert spent_s[1] < 3 * max(spent_s[0], TICKS_S)


@pytest.mark.parametrize("part", [1, 7, 100_000])
def test_the_next_request_is_found_behind_chunks_however_they_are_cut(touched_service: Service, part: int) -> None:
    body = b"".join(b"%X;a=b\r\n%b\r\n" % (len(words), words) for words in (b"\r\n\r\n", b"1\r\n" * 9, b"0\r\n\r\n"))
    head = HEAD + f"Authorization: Bearer {TOKEN}\r\n\r\n".encode()
    words = (head + body + b"000\r\nb: c\r\n\r\n" + get("/health/live")) * 2
    with connected(touched_service) as connection, connection.makefile("rb") as stream:
        for start in range(0, len(words), part):
            connection.sendall(words[start : start + part])
        connection.sendall(get("/health/live", "Connection: close"))
        answers = stream.read()
    assert [int(one[:3]) for one in answers.split(b"HTTP/1.1 ")[1:]] == [400, 200, 400, 200, 200]
