"""A service that is said to be elsewhere: the daemon sends neither its token nor its samples there."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, closing

import pytest

from beamtouch_daemon.delivery.client import ServiceClient, Verdict

pytestmark = pytest.mark.anyio

RECEIPT = b'{"accepted":0,"repeated":0,"durable":0,"expected":1,"stale_ms":500.0}'
TAKEN = b"HTTP/1.1 200 OK\r\nContent-Type: application/json\r\nContent-Length: %d\r\n\r\n" % len(RECEIPT) + RECEIPT
ELSEWHERE = "HTTP/1.1 {status} Elsewhere\r\nLocation: {url}\r\nContent-Length: 0\r\n\r\n"


@asynccontextmanager
async def answering(answer: bytes, heard: list[bytes]) -> AsyncIterator[str]:
    """Run a server that answers every request so, and keeps what it hears; gives its address."""

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with closing(writer):
            heard.append(await reader.read(65_536))
            writer.write(answer)

    async with await asyncio.start_server(serve, "127.0.0.1", 0) as server:
        yield f"http://127.0.0.1:{server.sockets[0].getsockname()[1]}"


@pytest.mark.parametrize("status", [301, 302, 303, 307, 308])
async def test_a_redirection_is_not_followed_and_its_batch_waits(status: int) -> None:
    proxy, stranger = list[bytes](), list[bytes]()
    async with answering(TAKEN, stranger) as elsewhere:
        answer = ELSEWHERE.format(status=status, url=f"{elsewhere}/surfaces/bench/samples").encode()
        async with answering(answer, proxy) as address, ServiceClient(address, "a-token") as client:
            posted = await client.post_samples("bench", None)
            asked = await client.get("/contact?surface=bench")
    assert stranger == []
    assert [b"a-token" in one for one in proxy] == [True, True]
    assert (posted.status, asked.status) == (status, status)
    # Nothing was taken: what is not durable stays in the log.
    assert (posted.verdict, posted.receipt) == (Verdict.LATER, None)
    assert posted.explanation == f"status {status}"
