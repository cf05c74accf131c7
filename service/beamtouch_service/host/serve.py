"""The running service: uvicorn as it comes, and the tasks beside it."""

import asyncio
import gc
import logging
import signal
import socket
import sys
from collections.abc import AsyncIterator, Callable, Coroutine, Mapping
from contextlib import asynccontextmanager
from functools import partial
from types import FrameType
from typing import Any

import uvicorn
from starlette.types import ASGIApp

from beamtouch_common.commands import announce
from beamtouch_common.log_lines import RepeatedFilter
from beamtouch_common.systemd import ServiceManager
from beamtouch_service.address import Address
from beamtouch_service.api.context import Context
from beamtouch_service.host.open_files import reject_when_out_of_descriptors
from beamtouch_service.sections import ServerSection
from beamtouch_service.surfaces import freshness

SHUTDOWN_S = 2
"""Time for running answers to finish. A sender repeats what was not acknowledged."""
IDLE_S = 75
"""A connection is closed this long after its last answer. Clients that poll do so more often."""
PROGRESS_S = 1.0
"""Longest time between two reports of progress."""

Task = Callable[[Context], Coroutine[Any, Any, None]]
"""Works beside the routes, until it is cancelled; one that fails is begun again."""
Tasks = Mapping[str, Task]
"""Each with the name under which log, readiness and metrics say that it fails."""


class Server(uvicorn.Server):
    """Calls hooks at startup and shutdown."""

    def __init__(self, config: uvicorn.Config, on_start: Callable[[], None], on_stop: Callable[[], None]) -> None:
        super().__init__(config)
        self._on_start, self._on_stop = on_start, on_stop

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Start to take connections."""
        await super().startup(sockets)
        self._on_start()

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Stop, after the running answers. A stream does not end by itself."""
        self._on_stop()
        await super().shutdown(sockets)


def configure(app: ASGIApp, server: ServerSection | None = None) -> uvicorn.Config:
    """Return the configuration of uvicorn."""
    server = server or ServerSection()
    return uvicorn.Config(
        app,
        http="httptools",
        ws="none",
        lifespan="off",
        log_config=None,
        log_level=logging.WARNING,
        access_log=False,
        server_header=False,
        # The client is the peer of the connection, whatever a header says.
        proxy_headers=False,
        timeout_graceful_shutdown=SHUTDOWN_S,
        timeout_keep_alive=IDLE_S,
        ssl_certfile=server.certificate_file,
        ssl_keyfile=server.key_file,
        # An empty passphrase: otherwise OpenSSL would ask for one at the terminal and wait.
        ssl_keyfile_password="" if server.key_file else None,
    )


def serve(config: uvicorn.Config, address: Address, context: Context, tasks: Tasks) -> None:
    """Serve until SIGTERM (then SystemExit 0) or Ctrl-C (then KeyboardInterrupt)."""
    # uvicorn shuts down on a signal and then raises it again.
    signal.signal(signal.SIGTERM, _exit_quietly)
    # Clients can provoke any number of its messages.
    logging.getLogger("uvicorn.error").addFilter(RepeatedFilter())
    # Objects that exist now stay for good. Searching them for garbage again and again would delay answers.
    gc.collect()
    gc.freeze()
    asyncio.run(_serve(config, address, context, tasks))


def _exit_quietly(_signal: int, _frame: FrameType | None) -> None:
    sys.exit(0)


async def _serve(config: uvicorn.Config, address: Address, context: Context, tasks: Tasks) -> None:
    """Run the tasks, and take connections once the address is there."""
    reject_when_out_of_descriptors()
    manager = ServiceManager()

    def note(reason: str) -> None:
        context.missing[address.section] = reason
        if reason:
            manager.ready(f"waiting: {reason}")

    def stop() -> None:
        manager.stopping()
        context.streams.stop()

    own: Tasks = {
        "clock": _tick,
        "progress": partial(_report_progress, manager=manager),
        "record": lambda context: context.recorder.run(),
    }
    async with _running(context, {**own, **tasks}):
        listener = await address.listen(note)
        host, port = listener.getsockname()[:2]
        shown = f"[{host}]" if listener.family is socket.AF_INET6 else host
        words = f"listening on {'https' if config.is_ssl else 'http'}://{shown}:{port}"

        def start() -> None:
            announce(words)
            manager.ready(words)

        await Server(config, start, stop).serve([listener])


@asynccontextmanager
async def _running(context: Context, work: Tasks) -> AsyncIterator[None]:
    """Run tasks during a block, and close the record after it."""
    tasks = [asyncio.create_task(context.parts.keep(name, partial(task, context))) for name, task in work.items()]
    try:
        yield
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        await context.recorder.close()


async def _report_progress(context: Context, *, manager: ServiceManager) -> None:
    """Report progress to the manager while the loop turns and every surface can be asked."""
    pause_s = min(PROGRESS_S, (manager.watchdog_s or PROGRESS_S) / 4)
    while True:
        for surface in context.registry:
            surface.view(context.clock())
        manager.alive()
        await asyncio.sleep(pause_s)


async def _tick(context: Context) -> None:
    """Tick, so that a pause of the process shows."""
    while True:
        context.stalls.tick(context.clock())
        await asyncio.sleep(freshness.TICK_S)
