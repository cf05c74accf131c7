"""A real HTTP server in the place of the service: it takes batches and answers as it is told."""

import asyncio
import gzip
import socket
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager, contextmanager
from pathlib import Path
from signal import SIGTERM
from time import monotonic

import httpx2
import uvicorn
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

from beamtouch_service.samples import Batch, Receipt, Sample
from support.network.plain_http import TIMEOUT_S
from support.programs.forked import Forked
from support.surfaces import configs

from .record import Record, Recorder

TOKEN = configs.TOKEN


class Service:
    """The batches that arrived, and the answers to them."""

    def __init__(self, address: tuple[str, int] = ("127.0.0.1", 0), record: Record | None = None) -> None:
        self.batches: list[tuple[str, Batch, float]] = []
        """Surface, batch and arrival of everything that was accepted."""
        self.record = record or Record()
        self.commit_s = 0.05
        """Time between two transactions of the record."""
        self.stale_ms = 500.0
        """Stated in each receipt."""
        self.attempts = 0
        self.loses_receipts = False
        """Whether batches are taken, and the answers to them lost."""
        self.recorder = Recorder(self.record)
        self._committed_s = monotonic()
        self._arrived = asyncio.Event()
        self.statuses: list[int] = []
        """Answers to come, one per request; 200 when there are no more."""
        self.wait_s: Callable[[Batch, int], float] = lambda _batch, _length: 0.0
        """Time before a batch of this length in bytes is answered."""
        self.problem_of: Callable[[Batch, int], tuple[int, str] | None] = lambda _batch, _length: None
        """The status and the type of the problem that a batch of this length in bytes is answered with, if any."""
        # With the protocol named, asyncio turns off the delay of small writes.
        self.listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM, socket.IPPROTO_TCP)
        self.listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self.listener.bind(address)
        self.listener.listen()
        self.port: int = self.listener.getsockname()[1]
        self.url = f"http://127.0.0.1:{self.port}"

    def samples(self, surface: str = "bench") -> list[Sample]:
        """Every accepted sample of a surface, as often as it came, in order of arrival."""
        return [sample for name, batch, _ in self.batches if name == surface for sample in batch.samples]

    def restart(self) -> None:
        """Forget what is not durable, as a service does that is killed."""
        self.recorder = Recorder(self.record)

    async def until(self, number: int, surface: str = "bench", within_s: float = 60.0) -> None:
        """Wait for the samples of a surface to be at least so many."""
        async with asyncio.timeout(within_s):
            while len(self.samples(surface)) < number:
                self._arrived.clear()
                await self._arrived.wait()

    async def take(self, request: Request) -> Response:
        """Answer a batch."""
        self.attempts += 1
        if request.headers.get("authorization") != f"Bearer {TOKEN}":
            return Response(status_code=401)
        body = await request.body()
        if request.headers.get("content-encoding") == "gzip":
            body = gzip.decompress(body)
        if body == b"{}":  # it asks whether samples would be taken
            return _problem(422, "invalid-request")
        batch = Batch.model_validate_json(body)
        await asyncio.sleep(self.wait_s(batch, len(body)))
        if refusal := self._refusal(batch, len(body)):
            return refusal
        receipt = self._receive(request.path_params["name"], batch)
        return Response(status_code=502) if self.loses_receipts else JSONResponse(receipt.model_dump())

    def _refusal(self, batch: Batch, length: int) -> Response | None:
        status = self.statuses.pop(0) if self.statuses else 200
        if status != 200:
            return Response(status_code=status)
        problem = self.problem_of(batch, length)
        return problem and _problem(*problem)

    def _receive(self, surface: str, batch: Batch) -> Receipt:
        self.batches.append((surface, batch, monotonic()))
        self._arrived.set()
        if monotonic() - self._committed_s > self.commit_s:
            self.recorder.commit()
            self._committed_s = monotonic()
        durable, expected = self.recorder.receive(surface, batch)
        return Receipt(
            accepted=len(batch.samples), repeated=0, durable=durable, expected=expected, stale_ms=self.stale_ms
        )


def _problem(status: int, kind: str) -> Response:
    if not kind:  # a proxy's
        return Response("<html>no</html>", status, media_type="text/html")
    return JSONResponse({"type": f"urn:beamtouch:problem:{kind}", "detail": "No."}, status)


@asynccontextmanager
async def serving(service: Service) -> AsyncIterator[Service]:
    """Run a service until the end of the block."""
    app = Starlette(routes=[Route("/surfaces/{name}/samples", service.take, methods=["POST"])])
    server = uvicorn.Server(uvicorn.Config(app, log_level="critical", lifespan="off", ws="none", access_log=False))
    task = asyncio.create_task(server.serve(sockets=[service.listener]))
    try:
        yield service
    finally:
        server.should_exit = True
        await asyncio.wait_for(task, 60)
        service.listener.close()


@contextmanager
def serving_model(folder: Path, model: Path, *options: str | Path, port: int = 0) -> Iterator[str]:
    """Run the real service with the surface that a model is named after; gives its address."""
    (folder / "token").write_text(TOKEN)
    words = ["run", "--model", model, "--write-token-file", folder / "token", "--port", port, *options]
    process = Forked("beamtouch_service.cli", list(map(str, words)), Path.cwd())
    try:
        yield process.stdout.readline().removeprefix("listening on ").strip()
    finally:
        process.send_signal(SIGTERM)
        process.communicate(timeout=60)


@asynccontextmanager
async def real_service(folder: Path, model: Path, *options: str | Path, port: int = 0) -> AsyncIterator[str]:
    """Do the same without holding up the event loop."""
    service = serving_model(folder, model, *options, port=port)
    url = await asyncio.to_thread(service.__enter__)
    try:
        yield url
    finally:
        await asyncio.to_thread(service.__exit__, None, None, None)


async def contact_has(url: str, name: str, value: str) -> None:
    """Wait until the contact of the real service has a member of this value."""
    async with httpx2.AsyncClient(base_url=url, trust_env=False, timeout=TIMEOUT_S) as http, asyncio.timeout(60):
        while (await http.get("/contact")).json().get(name) != value:  # noqa: ASYNC110 - the service is outside
            await asyncio.sleep(0.05)
