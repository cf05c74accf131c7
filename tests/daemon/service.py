"""A real HTTP server in the place of the service: it takes batches and answers as it is told."""

import asyncio
import socket
import sys
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from time import monotonic

import uvicorn
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

from beamtouch_service.samples import Batch, Receipt, Sample

TOKEN = "swordfish-of-the-tests-and-longer"  # noqa: S105


class Service:
    """The batches that arrived, and the answers to them."""

    def __init__(self, address: tuple[str, int] = ("127.0.0.1", 0)) -> None:
        self.batches: list[tuple[str, Batch, float]] = []
        """Surface, batch and arrival of everything that was accepted."""
        self.attempts = 0
        self._arrived = asyncio.Event()
        self.statuses: list[int] = []
        """Answers to come, one per request; 200 when there are no more."""
        self.is_busy_for: Callable[[Batch], bool] = lambda _: False
        """Which batches are refused for now."""
        self.problem_of: Callable[[Batch, int], tuple[int, str] | None] = lambda _batch, _length: None
        """The status and the type of the problem that a batch of this length in bytes is answered with, if any."""
        # With the protocol named, asyncio turns off the delay of small writes.
        self.listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM, socket.IPPROTO_TCP)
        self.listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self.listener.bind(address)
        self.listener.listen()
        self.url = f"http://127.0.0.1:{self.listener.getsockname()[1]}"

    def samples(self, surface: str = "bench") -> list[Sample]:
        """Every accepted sample of a surface, as often as it came, in order of arrival."""
        return [sample for name, batch, _ in self.batches if name == surface for sample in batch.samples]

    async def until(self, number: int, surface: str = "bench", within_s: float = 60.0) -> None:
        """Wait for the samples of a surface to be at least so many."""
        async with asyncio.timeout(within_s):
            while len(self.samples(surface)) < number:
                self._arrived.clear()
                await self._arrived.wait()

    async def take(self, request: Request) -> Response:
        self.attempts += 1
        if request.headers.get("authorization") != f"Bearer {TOKEN}":
            return Response(status_code=401)
        body = await request.body()
        batch = Batch.model_validate_json(body)
        status = self.statuses.pop(0) if self.statuses else 200
        if status != 200:
            return Response(status_code=status)
        if problem := self.problem_of(batch, len(body)):
            status, kind = problem
            if not kind:  # a proxy's
                return Response("<html>no</html>", status, media_type="text/html")
            return JSONResponse({"type": f"urn:beamtouch:problem:{kind}", "detail": "No."}, status)
        if self.is_busy_for(batch):
            return JSONResponse({"detail": "Busy; send the batch again."}, 503, {"Retry-After": "1"})
        self.batches.append((request.path_params["name"], batch, monotonic()))
        self._arrived.set()
        return JSONResponse(Receipt(accepted=len(batch.samples), repeated=0).model_dump())


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


@asynccontextmanager
async def real_service(folder: Path, model: Path, *options: str | Path, port: int = 0) -> AsyncIterator[str]:
    """Run the real service with the surface that a model is named after; gives its address."""
    (folder / "token").write_text(TOKEN)
    program = ["-m", "beamtouch_service.cli", "run", "--model", model, "--write-token-file", folder / "token"]
    pipe = asyncio.subprocess.PIPE
    words = [sys.executable, *map(str, [*program, "--port", port, *options])]
    process = await asyncio.create_subprocess_exec(*words, stdout=pipe, stderr=asyncio.subprocess.DEVNULL)
    try:
        assert process.stdout is not None
        line = await asyncio.wait_for(process.stdout.readline(), 120)
        yield line.decode().removeprefix("listening on ").strip()
    finally:
        process.terminate()
        await process.wait()
