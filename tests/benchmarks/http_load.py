"""Asks one address again and again over connections that stay open: `http_load.py PORT PATH CLIENTS SECONDS`.

Prints requests per second and percentiles of the time per answer as JSON. Little more than sockets, so that it is
quicker than any server it measures.
"""

import asyncio
import json
import sys
from functools import partial
from time import perf_counter


class Client(asyncio.Protocol):
    """One connection: the next request follows each answer at once."""

    def __init__(self, path: str, until_s: float, done: asyncio.Future[None]) -> None:
        self.took_s: list[float] = []
        self.statuses: set[bytes] = set()
        self._request = f"GET {path} HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n".encode()
        self._until_s = until_s
        self._done = done
        self._received = b""
        self._begin_s = 0.0

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport
        self._ask()

    def data_received(self, data: bytes) -> None:
        self._received += data
        head, separator, body = self._received.partition(b"\r\n\r\n")
        if not separator:
            return
        if not _is_whole(head, body):
            return
        now_s = perf_counter()
        self.took_s.append(now_s - self._begin_s)
        self.statuses.add(head[9:12])
        self._received = b""
        if now_s < self._until_s:
            self._ask()
        else:
            self._transport.close()
            self._done.set_result(None)

    def _ask(self) -> None:
        self._begin_s = perf_counter()
        self._transport.write(self._request)


def _is_whole(head: bytes, body: bytes) -> bool:
    begin = head.find(b"content-length: ") + 16
    if begin < 16:  # in chunks, the last of which is empty
        return body.endswith(b"\r\n0\r\n\r\n")
    end = head.find(b"\r", begin)
    return len(body) >= int(head[begin : end if end > 0 else None])


def _same(client: Client) -> Client:
    return client


async def load(port: int, path: str, clients: int, seconds: float) -> dict[str, float | list[str]]:
    """Ask for so many seconds; returns requests/s and percentiles [ms]."""
    loop = asyncio.get_running_loop()
    begin_s = perf_counter()
    done = [loop.create_future() for _ in range(clients)]
    running = [Client(path, begin_s + seconds, future) for future in done]
    for client in running:
        await loop.create_connection(partial(_same, client), "127.0.0.1", port)
    await asyncio.gather(*done)
    took_s = sorted(one for client in running for one in client.took_s)
    statuses = sorted({status.decode() for client in running for status in client.statuses})
    return {
        "count": len(took_s),
        "per_s": len(took_s) / (perf_counter() - begin_s),
        "p50_ms": took_s[len(took_s) // 2] * 1e3,
        "p99_ms": took_s[len(took_s) * 99 // 100] * 1e3,
        "statuses": statuses,
    }


if __name__ == "__main__":
    _, given_port, given_path, given_clients, given_seconds = sys.argv
    print(json.dumps(asyncio.run(load(int(given_port), given_path, int(given_clients), float(given_seconds)))))
