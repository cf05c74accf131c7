"""A way from a daemon to a service that keeps all samples which passed it, and that can be cut."""

import asyncio
import gzip
import json
import threading
import zlib
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx2
import uvicorn
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from support.network.free_ports import free_port
from support.running.waiting import wait_until

TIMEOUT_S = 10.0
_LENGTH = 4
_HEAD = {"boot_id", "channels", "noise_mm", "characteristic", "beam"}


class Tee:
    """Passes requests on to `target`; a context manager.

    Parameters
    ----------
    target : URL of a service
    file : where the batches are kept, compressed
    """

    def __init__(self, target: str, file: Path) -> None:
        self._target, self._path, self._file = target, file, file.open("wb")
        port = free_port()
        self.url = f"http://127.0.0.1:{port}"
        self._whole = threading.Event()
        self._whole.set()
        routes = [Route("/{path:path}", self._pass, methods=["GET", "POST"])]
        config = uvicorn.Config(Starlette(routes=routes), port=port, log_level="error", lifespan="off")
        self._server = uvicorn.Server(config)
        self._thread = threading.Thread(target=lambda: asyncio.run(self._server.serve()), daemon=True)
        self._client: httpx2.AsyncClient | None = None

    def start(self) -> None:
        """Start it."""
        self._thread.start()
        wait_until(lambda: self._server.started)

    def stop(self) -> None:
        """End it."""
        self.mend()
        self._server.should_exit = True
        self._thread.join()
        self._file.close()

    def cut(self) -> None:
        """Let requests wait without an answer, as in a network that drops every packet."""
        self._whole.clear()

    def mend(self) -> None:
        """Let requests through again; those that waited are lost."""
        self._whole.set()

    def batches(self) -> Iterator[tuple[str, dict[str, Any]]]:
        """Yield the surface and the batch of each request that passed, in order."""
        with self._path.open("rb") as file:
            while head := file.read(_LENGTH):
                surface, batch = json.loads(zlib.decompress(file.read(int.from_bytes(head, "big"))))
                yield surface, batch

    async def _pass(self, request: Request) -> Response:
        body = await request.body()
        is_gzip = request.headers.get("content-encoding") == "gzip"
        if not self._whole.is_set():
            await asyncio.to_thread(self._whole.wait)
            return Response(status_code=502)
        path = request.url.path
        if request.method == "POST" and path.endswith("/samples"):
            self._keep(path.split("/")[2], gzip.decompress(body) if is_gzip else body)
        if self._client is None:
            self._client = httpx2.AsyncClient(base_url=self._target, trust_env=False, timeout=TIMEOUT_S)
        headers = {name: value for name, value in request.headers.items() if name not in {"host", "connection"}}
        try:
            answer = await self._client.request(request.method, path, content=body, headers=headers)
        except httpx2.TransportError:
            return Response(status_code=502)
        kind = answer.headers.get("content-type")
        return Response(answer.content, answer.status_code, {"content-type": kind} if kind else None)

    def _keep(self, surface: str, body: bytes) -> None:
        content = zlib.compress(b'["%s",%s]' % (surface.encode(), body), 1)
        self._file.write(len(content).to_bytes(_LENGTH, "big") + content)
        self._file.flush()


class Boot:
    """All samples of one boot of a surface, each once."""

    def __init__(self, batch: dict[str, Any]) -> None:
        self.head = {name: value for name, value in batch.items() if name in _HEAD}
        self.samples: dict[int, dict[str, Any]] = {}
        self.notes: dict[int, list[str]] = {}

    def add(self, batch: dict[str, Any]) -> None:
        """Take the samples of a batch; one that came before must be the same."""
        for sample in batch["samples"]:
            number = sample["sequence"]
            if self.samples.setdefault(number, sample) != sample:
                raise AssertionError(f"sample {number} was sent with two contents")
            self.notes[number] = batch.get("notes", [])

    def missing(self) -> list[int]:
        """Return the numbers that never passed."""
        return sorted(set(range(1, max(self.samples, default=0) + 1)) - set(self.samples))

    def runs(self, most: int) -> Iterator[list[int]]:
        """Yield the numbers in order, in runs without a gap and with the same notes."""
        run: list[int] = []
        for number in sorted(self.samples):
            if run and (number != run[-1] + 1 or self.notes[number] != self.notes[run[-1]] or len(run) == most):
                yield run
                run = []
            run.append(number)
        if run:
            yield run


def boots_of(tee: Tee) -> dict[str, list[Boot]]:
    """Return the boots of each surface in the order in which they began."""
    found: dict[str, dict[str, Boot]] = defaultdict(dict)
    for surface, batch in tee.batches():
        found[surface].setdefault(batch["boot_id"], Boot(batch)).add(batch)
    return {surface: list(boots.values()) for surface, boots in found.items()}
